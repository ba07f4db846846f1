"""Static magnetic fields along a bore or a rail: of sources anywhere beside a long, narrow set of places.

In the ball about such places windings would stand, so solid harmonics do not converge there; waves along the cylinder about them do.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from jaxtyping import Float

from estimator.effects.base import Quantities, Theta, box, fixed, vector, written
from estimator.effects.circumstances import Extent
from estimator.effects.corrections.correction import Limit, constant
from estimator.effects.corrections.static import MIDDLE, StaticField, limit_of_places
from estimator.effects.stages import Field, Points
from estimator.field.bore import WAVES, bore_field
from estimator.tensors import Tensor, torch

NARROW = 2.0  # least length over diameter of the cylinder about the places; in a rounder set solid harmonics follow more with less
BEYOND = 2.5  # radii by which the cylinder is longer than the places at each end: half waves repeat beyond it as in a mirror, and what
# they say there would count as known (docs/decisions/0019)
STEEPEST = 8.0  # wavenumber times radius: steeper waves grow by a thousand from the axis to the wall
LEAST_RADIUS_M = 1e-6
FIXED = (*MIDDLE, "along_x", "along_y", "radius_m", "length_m")
TREND = tuple(f"{kind}_{term}" for kind, n in (("uniform", 1), ("slope", 2)) for term in WAVES[: 2 * n + 1])


class Cylinder(StaticField):
    """A field without sources in a cylinder about a line, which stays as it is.

    Degree 0 is the trend along it, higher ones are half waves.
    """

    lowest = 0
    highest = 24

    def terms(self, degree: int) -> tuple[str, ...]:
        """Terms of the trend for degree 0, else of a half wave: cosines and sines of up to six turns about the line."""
        return WAVES if degree else TREND

    def shapes(self, extent: Extent) -> Quantities:
        """Middle, direction, radius and length of the cylinder, in the frame of the field; the direction's z component is not negative."""
        sizes = (fixed(key, "m", 0.0, 4.0 * extent.reach_m) for key in ("radius_m", "length_m"))
        return (
            *box(MIDDLE, "", "m", 100.0 * extent.reach_m, is_fixed=True),
            *box(("along_x", "along_y"), "", "1", 1.0, is_fixed=True),
            *sizes,
        )

    def broken_rule(self, values: Mapping[str, float]) -> tuple[str, str] | None:
        """Radius and length are lengths, and the direction one of unit length."""
        if values["along_x"] ** 2 + values["along_y"] ** 2 > 1.0:
            return "along_y", "and along_x must be components of a unit vector"
        return next(((key, "must be > 0") for key in ("radius_m", "length_m") if values[key] <= 0.0), None)

    def around(self, places_m: Float[Tensor, "reading 3"]) -> dict[str, float]:
        """The cylinder about all places, along their widest extent."""
        middle_m = 0.5 * (places_m.max(0).values + places_m.min(0).values)
        along = torch.linalg.svd(places_m - places_m.mean(0), full_matrices=False).Vh[0]
        along = along if float(along[2]) >= 0.0 else -along
        x, y = (float(f"{float(c):.6g}") for c in along[:2])
        turn = _rotation(*places_m.new_tensor((x, y)))
        local_m = (places_m - middle_m) @ turn
        low_m, high_m = (float(end) for end in (local_m[:, 2].min(), local_m[:, 2].max()))
        middle_m = middle_m + 0.5 * (low_m + high_m) * turn[:, 2]
        radius_m = max(float(local_m[:, :2].norm(dim=-1).max()), LEAST_RADIUS_M)
        numbers = {f"middle_{axis}_m": float(m) for axis, m in zip("xyz", middle_m, strict=True)}
        numbers |= {"along_x": x, "along_y": y, "radius_m": radius_m}
        return written(numbers | {"length_m": high_m - low_m + 2.0 * BEYOND * radius_m})

    def limit_around(self, places_m: Float[Tensor, "reading 3"]) -> Limit:
        """Highest degree that the places determine, in a cylinder scaled to be as long as wide, whose waves are not too steep."""
        none = self.lowest - 1
        if not len(places_m):
            return Limit(none)
        cylinder = self.around(places_m)
        radius_m, length_m = cylinder["radius_m"], cylinder["length_m"]
        if length_m - 2.0 * BEYOND * radius_m < 2.0 * NARROW * radius_m:
            return Limit(none)  # rounder: solid harmonics are asked
        steepest = min(self.highest, int(STEEPEST * length_m / (math.pi * radius_m)))
        n_terms = {degree: len(TREND) + degree * len(WAVES) for degree in range(steepest + 1)}
        scaled = _in_radii(places_m, {key: places_m.new_tensor(number) for key, number in cylinder.items()})
        along = places_m.new_tensor([1.0, 1.0, 2.0 * radius_m / length_m])
        return limit_of_places(scaled * along, n_terms)

    def field(self, points_m: Points, theta: Theta) -> Field:
        """Field in the frame of the points, in the unit of the amplitudes."""
        amplitudes = self.amplitudes(theta)
        cylinder = {key: constant(theta, key) for key in FIXED}
        waves = {degree: amplitude for degree, amplitude in amplitudes.items() if degree}
        length = cylinder["length_m"] / cylinder["radius_m"]
        local = bore_field(_in_radii(points_m, cylinder), length, amplitudes.get(0), waves)
        return local @ _rotation(cylinder["along_x"], cylinder["along_y"]).mT


def _in_radii(points_m: Points, cylinder: Theta) -> Points:
    """Points about the middle of a cylinder, z along it, in units of its radius."""
    turn = _rotation(cylinder["along_x"], cylinder["along_y"])
    return (points_m - vector(cylinder, MIDDLE)[0]) @ turn / cylinder["radius_m"]


def _rotation(x: Float[Tensor, ""], y: Float[Tensor, ""]) -> Float[Tensor, "3 3"]:
    """The smallest turn of z into a direction, whose z component is not negative."""
    z = (1.0 - x * x - y * y).clamp(min=0.0).sqrt()
    rows = (
        (1.0 - x * x / (1.0 + z), -x * y / (1.0 + z), x),
        (-x * y / (1.0 + z), 1.0 - y * y / (1.0 + z), y),
        (-x, -y, z),
    )
    return torch.stack([torch.stack(row) for row in rows])
