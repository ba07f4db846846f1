"""What no laboratory is without, such as the Earth's field: fitted by a calibration whose rig file does not mention it."""

from __future__ import annotations

from dataclasses import dataclass

from estimator.effects import EFFECTS
from estimator.effects.attach import with_effect
from estimator.effects.circumstances import Circumstances
from estimator.readings.observations import Observations
from estimator.rig.rig import Cause, Rig
from estimator.tensors import torch

LEAST_SHARE = 0.01  # of a constant, left beside what is proportional to the currents: its error is then ten times that of a mean


@dataclass(frozen=True)
class WithEverywhere:
    """A rig with the effects that no laboratory is without.

    Attributes:
        rig: With those that it did not mention, free.
        added: Which these are.
        missing: Those that the readings cannot tell from the fields of the coils, so that they were not added.
    """

    rig: Rig
    added: tuple[Cause, ...] = ()
    missing: tuple[Cause, ...] = ()


def with_everywhere(rig: Rig, observations: Observations) -> WithEverywhere:
    """Add what no laboratory is without to a rig that does not mention it.

    Args:
        rig: As described by its file.
        observations: Readings of the fit. They tell a constant from the fields of the coils where the currents change: by readings
            without current, of both signs or of two sizes.
    """
    circumstances = Circumstances(rig, observations)
    unmentioned = tuple(
        Cause(effect.name, place)
        for effect in EFFECTS.values()
        if effect.is_everywhere
        for place in effect.places(rig)
        if Cause(effect.name, place) not in rig.acting and effect.concerns(circumstances, place)
    )
    if not tells_constant(observations):
        return WithEverywhere(rig, missing=unmentioned)
    for cause in unmentioned:
        rig = with_effect(rig, cause, observations, {})
    return WithEverywhere(rig, added=unmentioned)


def tells_constant(observations: Observations) -> bool:
    """Whether the currents of some readings tell a constant field from fields that are proportional to them."""
    currents_A = observations.current_A.to(torch.float64).cpu()
    constant = torch.ones(len(currents_A), 1, dtype=torch.float64)
    orthonormal, size, _ = torch.linalg.svd(currents_A, full_matrices=False)
    span = orthonormal[:, size > 1e-9 * size.max().clamp(min=1e-300)]
    left = constant - span @ (span.T @ constant)
    return float(left.square().sum()) > LEAST_SHARE * len(currents_A)
