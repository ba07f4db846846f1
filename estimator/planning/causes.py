"""Causes free beside a rig: those that a plan shall make visible, and ordinary ones that a calibration leaves out.

All quantities that goals name are free together, each within its prior. What cannot be told apart is then known no better than its prior,
and the goal is refused with its names.

Those that one moment shows are among them, if they have no shapes. What follows time or order shows where stops are visited again; what is
built into a winding is left to the rig file and to held-out stops.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

from estimator.diagnosis.policy import VISIBLE_SIGMA
from estimator.effects import EFFECTS
from estimator.effects.attach import with_effect
from estimator.effects.circumstances import Circumstances
from estimator.effects.stages import NoiseEffect
from estimator.errors import InvalidInput, quoted
from estimator.field.winding_shape import DEFAULT_TOLERANCE, Rule
from estimator.inference.likelihood import LogPosterior
from estimator.model.hide import cause_of
from estimator.model.simulate import perfect_readings
from estimator.readings.metrics import HALF_WIDTH_90
from estimator.readings.observations import Observations
from estimator.rig.coordinates import Coordinates
from estimator.rig.rig import Cause, Rig
from estimator.tensors import torch


def with_causes(rig: Rig, stops: Observations, goals: Sequence[str]) -> Rig:
    """The rig with the quantities of causes that goals name, free and at their null.

    Args:
        rig: Without them.
        stops: Candidates, whose extent sets the priors.
        goals: As users write them.
    Raises:
        InvalidInput: A cause is unknown, changes no reading, or depends on when a stop is visited.
    """
    named = [word for text in goals for kind, *words in [text.split()] for word in words if kind == "causes"]
    names = {name for word in named for name in _sizes(word, rig)}
    for cause in dict.fromkeys(cause_of(word.partition("=")[0], rig) for word in named):
        effect, circumstances = EFFECTS[cause.name], Circumstances(rig, stops)
        if cause in rig.acting:
            continue
        if isinstance(effect, NoiseEffect) or not effect.concerns(circumstances, cause.place):
            raise InvalidInput(
                f"causes of a goal must change readings at the candidate stops; {cause.label} does not"
            )
        rig = with_effect(rig, cause, stops, effect.starts(circumstances, cause.place)[0])
        own = [p.name for p in rig.free if p.name.startswith(f"{cause.label}.")]
        if effect.is_record_mistake or _depends_on_time(rig, own, stops):
            raise InvalidInput(
                f"causes of a goal must not depend on when a stop is visited; {cause.label} does"
            )
        rig = rig.with_fixed([name for name in own if name not in names])
    return rig


def _depends_on_time(rig: Rig, names: Sequence[str], stops: Observations) -> bool:
    """Whether readings change with the order of the stops where some quantities have the sizes of their priors."""
    real = rig.with_values({p.name: p.value + p.prior.sd for p in rig.free if p.prior and p.name in names})
    backwards = replace(stops, time_s=stops.time_s.flip(0))
    forth_T, back_T = (perfect_readings(real, each, DEFAULT_TOLERANCE) for each in (stops, backwards))
    return not torch.allclose(forth_T, back_T, rtol=1e-9, atol=1e-12)


def visible_half_widths(words: Sequence[str], rig: Rig) -> dict[str, float]:
    """Half-widths of 90 % intervals at which quantities of causes show by five standard deviations.

    Args:
        words: As `axis_gain[hall].x=0.01`, in SI; without a size it is that of the prior, without a quantity the first one.
        rig: That has the causes (`with_causes`).
    """
    sizes = {name: size for word in words for name, size in _sizes(word, rig).items()}
    free = {p.name: p.prior.sd for p in rig.free if p.prior}
    return {name: HALF_WIDTH_90 * (size or free[name]) / VISIBLE_SIGMA for name, size in sizes.items()}


def _sizes(word: str, rig: Rig) -> dict[str, float]:
    """Name of the quantity that a word means, with its size; 0 where none is given."""
    name, _, size = word.partition("=")
    cause = cause_of(name, rig)
    effect = EFFECTS[cause.name]
    keys = [q.key for q in effect.quantities(effect.extent_of(())) if not q.is_shape]
    key = name.rpartition(".")[2] if "." in name else keys[0]
    if key not in keys:
        raise InvalidInput(
            f"causes of a goal must be given by one of {', '.join(keys)}; received {quoted(word)}"
        )
    try:
        return {f"{cause.label}.{key}": abs(float(size)) if size else 0.0}
    except ValueError as error:
        raise InvalidInput(
            f"causes of a goal must have sizes that are numbers; received {quoted(word)}"
        ) from error


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
