"""Ordinary causes that a calibration leaves out, such as the gain of an axis: free beside a rig, each at its null and within its prior.

Those that one moment shows are among them, if they have no shapes. What follows time or order shows where stops are visited again; what is
built into a winding is left to the rig file and to held-out stops.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

from estimator.effects import EFFECTS
from estimator.effects.attach import with_effect
from estimator.effects.circumstances import Circumstances
from estimator.effects.stages import NoiseEffect
from estimator.field.winding_shape import DEFAULT_TOLERANCE, Rule
from estimator.inference.likelihood import LogPosterior
from estimator.model.simulate import perfect_readings
from estimator.readings.observations import Observations
from estimator.rig.coordinates import Coordinates
from estimator.rig.rig import Cause, Rig
from estimator.tensors import torch

N_COMPARED = 12  # stops, at two times each: what depends on time or order changes at any of them


def with_ordinary(rig: Rig, stops: Observations, rules: Mapping[str, Rule]) -> Rig:
    """The rig with the ordinary causes that it does not have, free and at their null.

    Args:
        rig: As it is fitted.
        stops: Candidates, a row for each sensor; their extent sets the priors.
        rules: Quadrature rule of each winding.
    """
    read = stops.with_field(perfect_readings(rig, stops, DEFAULT_TOLERANCE).expand(len(stops), 3))
    circumstances = Circumstances(rig, read)

    def extended(causes: Iterable[Cause]) -> Rig:
        result = rig
        for cause in causes:
            result = with_effect(result, cause, read, {}, circumstances=circumstances)
        return result

    causes = list(_at_any_time(rig, circumstances))
    whole = extended(causes)
    coordinates, few = Coordinates(whole), read.rows(torch.arange(min(len(read), N_COMPARED))).alone
    backwards = replace(few, time_s=few.time_s.flip(0))
    forth_T, back_T = (
        LogPosterior.by_rules(coordinates, each, rules).jacobian(coordinates.start())
        for each in (few, backwards)
    )
    is_steady = torch.isclose(forth_T, back_T, rtol=1e-6, atol=1e-12).all(0).tolist()
    unsteady = {
        name.partition(".")[0] for name, ok in zip(coordinates.names, is_steady, strict=True) if not ok
    }
    return extended(cause for cause in causes if cause.label not in unsteady)


def _at_any_time(rig: Rig, circumstances: Circumstances) -> Iterator[Cause]:
    """Causes without shapes that may be there in any session."""
    for name, effect in EFFECTS.items():
        if effect.is_record_mistake or effect.is_correction or isinstance(effect, NoiseEffect):
            continue
        if not effect.can_begin or effect.is_structural:
            continue
        for place in effect.places(rig):
            cause = Cause(name, place)
            if cause in rig.acting or not effect.concerns(circumstances, place):
                continue
            is_plain = not any(quantity.is_shape for quantity in effect.quantities(circumstances.extent))
            if is_plain and effect.starts(circumstances, place) == ({},):
                yield cause
