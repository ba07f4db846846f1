"""A piece of iron on the holder of a sensor."""

from __future__ import annotations

import math
from itertools import product

from estimator.effects.base import Theta, at_least_zero, box, vector
from estimator.effects.circumstances import Circumstances
from estimator.effects.stages import Components, HolderEffect, Vector
from estimator.field.dipole import dipole_field

RADIUS_M = 4e-3  # likely, of an equivalent ball of iron
MOST_OF_DISTANCE = 0.4  # from the sensor, for its radius: it adds a sixth of the field at most
FARTHEST_M, DISTANCES_M = 0.06, (0.012, 0.035)  # from the sensor


# Along the axes of the sensor's frame and between each three of them, at two distances.
DIRECTIONS = tuple(each for each in product((-1, 0, 1), repeat=3) if sum(map(abs, each)) in (1, 3))
PLACES = tuple(
    {f"{axis}_m": distance_m * each / math.hypot(*way) for axis, each in zip("xyz", way, strict=True)}
    for way in DIRECTIONS
    for distance_m in DISTANCES_M
)


def _has_moved(circumstances: Circumstances, place: str) -> bool:
    """Whether the sensor moved; what moves with one that stands still stands in the room."""
    carried_by = circumstances.rig.sensors[circumstances.sensor_number(place)].carried_by
    if carried_by is None:
        return False
    motion = circumstances.observations.motion[carried_by]
    return bool((motion != motion[:1]).any())


def _place_m(theta: Theta) -> Vector:
    """Place of its middle, in the sensor frame."""
    return vector(theta, "xyz", "_m")[..., 0, :]


def _is_small(theta: Theta) -> bool:
    """Whether it is far smaller than its distance: a ball beside which the sensor reads some other field altogether is no screw."""
    largest_m = MOST_OF_DISTANCE * float(_place_m(theta).norm())
    return float(theta["radius_cubed_m3"]) < largest_m**3


# Quantities: radius cubed of an equivalent ball of iron, and where it sits in the sensor's frame.
@HolderEffect.cause(
    "answer_T",
    quantities=(at_least_zero("radius_cubed_m3", "m3", RADIUS_M**3), *box("xyz", "_m", "m", FARTHEST_M)),
    concerns=_has_moved,
    starts=PLACES,
    is_itself=_is_small,
    place_m=_place_m,
)
def iron_on_sensor(field_there_T: Components, theta: Theta) -> Components:
    """A piece of iron moves with the sensor.

    A small piece of soft iron on the sensor's holder is magnetised by the field there and answers as a dipole.

    Source: a screw or a nut of a probe's holder is like a ball of 1 to 4 mm.
    """
    # Field of the dipole 4 pi a^3 / mu0 times the field there.
    to_sensor_m = -vector(theta, "xyz", "_m")
    return theta["radius_cubed_m3"][..., None, None] * dipole_field(to_sensor_m, field_there_T)
