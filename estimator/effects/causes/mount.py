"""How a body sits on what carries it: askew, or elsewhere from one instant on."""

from __future__ import annotations

import math
from collections.abc import Mapping

from estimator.effects.base import WHEN, Kind, Theta, since, triple, vector
from estimator.effects.causes.misplaced import is_displaced
from estimator.effects.circumstances import SINCE, Circumstances
from estimator.effects.during import from_instants
from estimator.effects.stages import Columns, MountEffect
from estimator.frames import Transform, rotation_from_vector
from estimator.tensors import Tensor, torch


def shift(shift_m: Tensor) -> Transform:
    """A shift without a turn."""
    return Transform(torch.eye(3, dtype=shift_m.dtype, device=shift_m.device).expand(1, 3, 3), shift_m)


# Quantities: rotation vector across the body's axis; a turn about it is absorbed by the pose (docs/explanation/field-model.md).
@MountEffect.cause(
    quantities=triple("xy", "_rad", "rad", math.radians(1.5)),
    kind=Kind.MOVER,
    places=lambda rig: tuple(body.name for body in (*rig.coils, *rig.sensors) if is_displaced(rig, body)),
    is_at_reference=True,
)
def mount_tilt(theta: Theta) -> Transform:
    """The body sits askew on its flange: displacements run in other directions than assumed.

    The body sits turned on its flange, so that the mover's displacements run askew in its frame.

    Source: a printed or bolted mount, 1 to 2 degrees.
    """
    zero = torch.zeros_like(theta["x_rad"])
    rotation = rotation_from_vector(torch.stack((theta["x_rad"], theta["y_rad"], zero), dim=-1))
    return Transform(rotation[..., None, :, :], rotation.new_zeros(1, 3))


def _is_after(circumstances: Circumstances, theta: Mapping[str, float]) -> Columns:
    """1 at readings from the instant on, else 0."""
    return (circumstances.hours >= theta[SINCE]).to(circumstances.hours)[:, None]


# Quantities: shift in the sensor's frame, and the time since the session began at which it happened.
@MountEffect.cause(
    quantities=lambda extent: (*triple("xyz", "_m", "m", 500e-6), since(extent)),
    kind=Kind.SENSOR,
    starts=lambda circumstances: from_instants(({},), circumstances),
    columns=_is_after,
    depends_on=WHEN,
    is_step=True,
)
def sensor_bumped(columns: Columns, theta: Theta) -> Transform:
    """From one instant on the sensor sits elsewhere.

    Somebody touched the sensor: from one instant on it sits elsewhere.

    Source: a touch moves a clamped probe by 0.1 to 1 mm.
    """
    return shift(vector(theta, "xyz", "_m") * columns)
