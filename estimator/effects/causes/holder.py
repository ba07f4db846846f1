"""A piece of iron on the holder of a sensor."""

from __future__ import annotations

import math
from itertools import product

from estimator.effects.base import Quantities, Starts, Theta, at_least_zero, box, vector
from estimator.effects.circumstances import Circumstances, Extent
from estimator.effects.stages import Components, HolderEffect, Vector
from estimator.field.dipole import dipole_field

RADIUS_M = 4e-3  # likely, of an equivalent ball of iron
MOST_OF_DISTANCE = 0.4  # from the sensor, for its radius: it adds a sixth of the field at most
FARTHEST_M, DISTANCES_M = 0.06, (0.012, 0.035)  # from the sensor


class IronOnSensor(HolderEffect):
    """A small piece of soft iron on the sensor's holder is magnetised by the field there and answers as a dipole."""

    name = "iron_on_sensor"
    words = "a piece of iron moves with the sensor"
    source = "a screw or a nut of a probe's holder is like a ball of 1 to 4 mm"

    def quantities(self, extent: Extent) -> Quantities:
        """Radius cubed of an equivalent ball of iron, and where it sits in the sensor's frame."""
        return (at_least_zero("radius_cubed_m3", "m3", RADIUS_M**3), *box("xyz", "_m", "m", FARTHEST_M))

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether the sensor moved; what moves with one that stands still stands in the room."""
        carried_by = circumstances.rig.sensors[circumstances.sensor_number(place)].carried_by
        if carried_by is None:
            return False
        motion = circumstances.observations.motion[carried_by]
        return bool((motion != motion[:1]).any())

    def starts(self, circumstances: Circumstances, place: str) -> Starts:
        """Along the axes of the sensor's frame and between each three of them, at two distances."""
        directions = [each for each in product((-1, 0, 1), repeat=3) if sum(map(abs, each)) in (1, 3)]
        return tuple(
            {
                f"{axis}_m": distance_m * each / math.hypot(*direction)
                for axis, each in zip("xyz", direction, strict=True)
            }
            for direction in directions
            for distance_m in DISTANCES_M
        )

    def is_itself(self, theta: Theta, circumstances: Circumstances) -> bool:
        """While it is far smaller than its distance: a ball beside which the sensor reads some other field altogether is no screw."""
        largest_m = MOST_OF_DISTANCE * float(self.place_m(theta).norm())
        return float(theta["radius_cubed_m3"]) < largest_m**3

    def place_m(self, theta: Theta) -> Vector:
        """Place of its middle, in the sensor frame."""
        return vector(theta, "xyz", "_m")[..., 0, :]

    def answer_T(self, field_there_T: Components, theta: Theta) -> Components:
        """Field of the dipole 4 pi a^3 / mu0 times the field there."""
        return theta["radius_cubed_m3"][..., None, None] * dipole_field(
            -self.place_m(theta)[..., None, :], field_there_T
        )
