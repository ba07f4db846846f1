"""Corrections that are static magnetic fields along a bore or a rail: of sources anywhere beside a long, narrow set of places.

In the ball about such places windings would stand, so solid harmonics do not converge there; waves along the cylinder about them do.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

from jaxtyping import Float

from estimator.effects.base import Quantity, Theta, shape
from estimator.effects.circumstances import Circumstances, Extent
from estimator.effects.corrections.correction import Correction, Limit, limit_of_places, positions_m
from estimator.effects.corrections.harmonics import CoilField, room_is_hidden
from estimator.effects.stages import RoomEffect
from estimator.field.bore import WAVES, bore_field
from estimator.field.coil import AnyWinding
from estimator.field.winding import Rule
from estimator.tensors import Tensor, torch

NARROW = 2.0  # least length over diameter of the cylinder about the places; in a rounder set solid harmonics follow more with less
BEYOND = 2.5  # radii by which the cylinder is longer than the places at each end: half waves repeat beyond it as in a mirror, and what
# they say there would count as known (docs/decisions/0019)
STEEPEST = 8.0  # wavenumber times radius: steeper waves grow by a thousand from the axis to the wall
LEAST_RADIUS_M = 1e-6
FIXED = ("middle_x_m", "middle_y_m", "middle_z_m", "along_x", "along_y", "radius_m", "length_m")
TREND = tuple(f"{kind}_{term}" for kind, n in (("uniform", 1), ("slope", 2)) for term in WAVES[: 2 * n + 1])


class _Bore(Correction):
    """A field without sources in a cylinder about a line, which stays as it is.

    Degree 0 is the trend along it, higher ones are half waves.
    """

    lowest: ClassVar[int] = 0
    highest: ClassVar[int] = 24

    def terms(self, degree: int) -> tuple[str, ...]:
        """Terms of the trend for degree 0, else of a half wave: cosines and sines of up to six turns about the line."""
        return WAVES if degree else TREND

    def shapes(self, extent: Extent) -> tuple[Quantity, ...]:
        """Middle, direction, radius and length of the cylinder, in the frame of the field; the direction's z component is not negative."""
        ends_m = 100.0 * extent.reach_m
        return (
            *(shape(f"middle_{axis}_m", "m", -ends_m, ends_m, is_fixed=True) for axis in "xyz"),
            *(shape(f"along_{axis}", "1", -1.0, 1.0, is_fixed=True) for axis in "xy"),
            *(
                shape(f"{size}_m", "m", 0.0, 4.0 * extent.reach_m, is_fixed=True)
                for size in ("radius", "length")
            ),
        )

    def broken_rule(self, values: dict[str, float]) -> tuple[str, str] | None:  # type: ignore[override]
        """Radius and length are lengths, and the direction one of unit length."""
        if values["along_x"] ** 2 + values["along_y"] ** 2 > 1.0:
            return "along_y", "and along_x must be components of a unit vector"
        return next(((key, "must be > 0") for key in ("radius_m", "length_m") if values[key] <= 0.0), None)

    @staticmethod
    def around(places_m: Float[Tensor, "reading 3"]) -> dict[str, float]:
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
        numbers |= {"length_m": high_m - low_m + 2.0 * BEYOND * radius_m}
        return {key: float(f"{number:.6g}") for key, number in numbers.items()}

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

    def field(
        self, points_m: Float[Tensor, "*#batch point 3"], theta: Theta
    ) -> Float[Tensor, "*batch point 3"]:
        """Field in the frame of the points, in the unit of the amplitudes."""
        amplitudes = self.amplitudes(theta)
        cylinder = {key: theta[key].flatten()[0] for key in FIXED}  # alike in a batch
        waves = {degree: amplitude for degree, amplitude in amplitudes.items() if degree}
        length = cylinder["length_m"] / cylinder["radius_m"]
        local = bore_field(_in_radii(points_m, cylinder), length, amplitudes.get(0), waves)
        return local @ _rotation(cylinder["along_x"], cylinder["along_y"]).mT


class CoilBore(_Bore, CoilField):
    """What sources beside the places add to a coil: a winding of another shape than said, iron, leads."""

    name: ClassVar[str] = "coil_bore"
    words: ClassVar[str] = "a field along the bore that moves with the coil and goes with its current"

    def limit(self, circumstances: Circumstances, place: str) -> Limit:
        """Highest degree that the places of the readings in the coil's frame determine."""
        return self.limit_around(self.read_at_m(circumstances, place))

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """The cylinder about the readings."""
        return (self.around(self.read_at_m(circumstances, place)),)

    def apply(
        self, points_coil_m: Float[Tensor, "*#batch pose 3"], winding: AnyWinding, rule: Rule, theta: Theta
    ) -> Float[Tensor, "*#batch pose 3"]:
        """Field in the coil frame per ampere."""
        return self.field(points_coil_m, theta)


class RoomBore(_Bore, RoomEffect):
    """What sources beside the places add without current: magnetised windings and steel."""

    name: ClassVar[str] = "room_bore"
    words: ClassVar[str] = "a field along the bore that stays in the room"
    is_background: ClassVar[bool] = True

    def limit(self, circumstances: Circumstances, place: str) -> Limit:
        """Highest degree that the places of the readings in the room determine; none where currents and coils' poses never changed."""
        words = room_is_hidden(circumstances)
        return Limit(self.lowest - 1, words) if words else self.limit_around(positions_m(circumstances))

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """The cylinder about the readings."""
        return (self.around(positions_m(circumstances)),)

    def steady_T(
        self, points_m: Float[Tensor, "*#batch pose 3"], theta: Theta
    ) -> Float[Tensor, "*#batch pose 3"]:
        """Field in the world frame."""
        return self.field(points_m, theta)


def _in_radii(
    points_m: Float[Tensor, "*#batch point 3"], cylinder: Mapping[str, Tensor]
) -> Float[Tensor, "*#batch point 3"]:
    """Points about the middle of a cylinder, z along it, in units of its radius."""
    middle_m = torch.stack([cylinder[f"middle_{axis}_m"] for axis in "xyz"])
    local: Tensor = (points_m - middle_m) @ _rotation(cylinder["along_x"], cylinder["along_y"])
    return local / cylinder["radius_m"]


def _rotation(x: Float[Tensor, ""], y: Float[Tensor, ""]) -> Float[Tensor, "3 3"]:
    """The smallest turn of z into a direction, whose z component is not negative."""
    z = (1.0 - x * x - y * y).clamp(min=0.0).sqrt()
    rows = (
        (1.0 - x * x / (1.0 + z), -x * y / (1.0 + z), x),
        (-x * y / (1.0 + z), 1.0 - y * y / (1.0 + z), y),
        (-x, -y, z),
    )
    return torch.stack([torch.stack(row) for row in rows])
