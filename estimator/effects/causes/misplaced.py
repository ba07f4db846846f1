"""Bodies that sit elsewhere than the rig file says, as a whole or in parts.

A number that the rig file leaves free, and loosely, follows what the readings say: what a cause here would change is then projected away,
and its evidence is gone by itself. Where the file fixes a number, or knows it tightly, nothing but such a cause can say that it is wrong.
"""

from __future__ import annotations

import math

from jaxtyping import Float

from estimator.effects.base import Kind, Quantities, Theta, triple, vector
from estimator.effects.circumstances import Circumstances
from estimator.effects.stages import ElementEffect, MountEffect
from estimator.frames import Transform, rotation_from_vector
from estimator.rig.bodies import Body, MotionKind, SidedCoil
from estimator.rig.rig import Rig
from estimator.tensors import Tensor

ELEMENTS = tuple(f"{element}_at_{axis}_m" for element in "xyz" for axis in "xyz")
ASKEW_KEYS = frozenset(("rx_rad", "ry_rad"))  # as `mount_tilt` has them


def elsewhere(shift_m: float, turn_rad: float) -> Quantities:
    """Shift and rotation vector of a body, with their standard deviations."""
    return (*triple("xyz", "_m", "m", shift_m), *triple(("rx", "ry", "rz"), "_rad", "rad", turn_rad))


def of_numbers(theta: Theta) -> Transform:
    """The transform of six such numbers, with a pose axis of length 1."""
    turn_rad = vector(theta, ("rx", "ry", "rz"), "_rad")[..., 0, :]
    return Transform(rotation_from_vector(turn_rad)[..., None, :, :], vector(theta, "xyz", "_m"))


def is_displaced(rig: Rig, body: Body) -> bool:
    """Whether a mover carries the body and reports displacements."""
    return body.carried_by is not None and rig.mover(body.carried_by).motion is MotionKind.DISPLACEMENT


def _askew(circumstances: Circumstances, place: str) -> frozenset[str]:
    """A turn across the axis of a displaced body whose reference pose may turn as far: that is `mount_tilt`, to the last digit."""
    rig = circumstances.rig
    bodies = [("coil", coil) for coil in rig.coils] + [("sensor", sensor) for sensor in rig.sensors]
    kind, body = next((kind, body) for kind, body in bodies if body.name == place)
    if not is_displaced(rig, body):
        return frozenset()
    pose0 = f"{place}.world_from_{kind}0"
    priors = [rig.parameters[f"{pose0}.{key}"].prior for key in ("tilt_x_rad", "tilt_y_rad")]
    is_loose = all(prior is not None and prior.sd >= math.radians(1.0) for prior in priors)
    return ASKEW_KEYS if is_loose else frozenset()


# Quantities: in its own frame.
@MountEffect.cause(quantities=elsewhere(1e-3, math.radians(1.0)), kind=Kind.SENSOR, unseen=_askew)
def sensor_misplaced(theta: Theta) -> Transform:
    """The sensor sits elsewhere on its holder, or turned in it.

    Source: probes are glued or clamped to about 1 mm and 1 degree.
    """
    return of_numbers(theta)


def _askew_or_about_the_axis(circumstances: Circumstances, place: str) -> frozenset[str]:
    """Nor a turn about the axis of a round coil, or one without a winding, that is not displaced: nobody could tell."""
    coil = circumstances.rig.coils[circumstances.coil_number(place)]
    can_show = is_displaced(circumstances.rig, coil) or isinstance(coil, SidedCoil)
    return _askew(circumstances, place) | frozenset(() if can_show else ("rz_rad",))


# Quantities: in its own frame.
@MountEffect.cause(
    quantities=elsewhere(1e-3, math.radians(1.0)), kind=Kind.COIL, unseen=_askew_or_about_the_axis
)
def coil_misplaced(theta: Theta) -> Transform:
    """The coil sits elsewhere than stated, or turned there.

    The coil sits elsewhere on what carries it, or in the room, or is turned there.

    Source: coils are bolted or clamped to about 1 mm and 1 degree.
    """
    return of_numbers(theta)


# Quantities: position of each element from where the sensor is said to be, in the sensor frame.
@ElementEffect.cause(quantities=triple(ELEMENTS, "", "m", 500e-6))
def element_displacement(theta: Theta) -> Float[Tensor, "*batch 3 3"]:
    """The sensor's three elements sit at different positions.

    The elements of the three axes sit at different positions in the probe.

    A shift that all three share looks like another place of the sensor. So each number by itself stays as wide as its prior where that
    place is free, and differences such as `z_at_x_m - x_at_x_m` are known far better.

    Source: probes of separate elements: 0.1 to 2 mm; integrated ones below 0.1 mm.
    """
    return vector(theta, ELEMENTS)[..., 0, :].unflatten(-1, (3, 3))
