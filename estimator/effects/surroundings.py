"""Fields of the room: what is there without current, and iron that answers the coils."""

from __future__ import annotations

import math
from typing import ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.effects.base import PerAmpere, Quantity, RoomEffect, Theta, at_least_zero, shape, triple
from estimator.effects.scene import Extent, Scene
from estimator.units import MU0_T_M_PER_A

QUARTER_TURN = 0.5 * math.pi
LEAST_BETWEEN = (
    0.5  # of the reach: how far places lie apart for a plate with an opening to stand between them
)
BETWEEN = (0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875)
MU0_OVER_4PI = MU0_T_M_PER_A / (4.0 * math.pi)


class BackgroundField(RoomEffect):
    """A uniform field of the room, such as the Earth's."""

    name: ClassVar[str] = "background_field"
    words: ClassVar[str] = "a constant field of the room adds to that of the coils"
    source: ClassVar[str] = "the Earth's field, 25 to 65 uT (IGRF-13)"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Components in the world frame."""
        return triple("xyz", "_T", "T", 50e-6)

    def constant_T(self, theta: Theta, scene: Scene) -> Float[Tensor, "*#batch reading 3"]:
        """The same at every reading."""
        field = self.field_T(theta)
        return field[..., None, :].expand(*field.shape[:-1], len(scene), 3)

    def field_T(self, theta: Theta) -> Float[Tensor, "*batch 3"]:
        """The field, in the world frame."""
        return torch.stack([theta[f"{axis}_T"] for axis in "xyz"], dim=-1)


class BackgroundDrift(RoomEffect):
    """The field of the room changes steadily."""

    name: ClassVar[str] = "background_drift"
    words: ClassVar[str] = "the field of the room drifts"
    source: ClassVar[str] = "lifts, trams and magnets next door: some 10 uT within a session"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Change per hour in the world frame, from the beginning of the session on."""
        return triple("xyz", "_T_per_h", "T/h", 50e-6 / extent.duration_h)

    def constant_T(self, theta: Theta, scene: Scene) -> Float[Tensor, "*#batch reading 3"]:
        """Proportional to the time since the session began."""
        rate = torch.stack([theta[f"{axis}_T_per_h"] for axis in "xyz"], dim=-1)
        return rate[..., None, :] * scene.hours[:, None]


class IronPlate(RoomEffect):
    """A large plate of iron mirrors the coils and shields what is behind it."""

    name: ClassVar[str] = "iron_plate"
    words: ClassVar[str] = "a plate of iron mirrors the coils and shields what is behind it"
    source: ClassVar[str] = "strength (mu - 1) / (mu + 1) is below 1; a thin or far plate gives less"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Strength of image and shield, direction from the world's origin to the plane, and its distance."""
        return (
            at_least_zero("strength", "1", 0.5),
            shape("azimuth_rad", "rad", -2.0 * math.pi, 2.0 * math.pi),
            shape("elevation_rad", "rad", -math.pi, math.pi),
            shape("distance_m", "m", -8.0 * extent.reach_m, 8.0 * extent.reach_m),
        )

    def starts(self, scene: Scene, place: str) -> tuple[dict[str, float], ...]:
        """Planes across the world's axes, behind whatever stands there, and between the sensors' places where these lie apart."""
        starts = []
        for azimuth, elevation in [(QUARTER_TURN * i, 0.0) for i in range(4)] + [
            (0.0, s * QUARTER_TURN) for s in (-1, 1)
        ]:
            normal_vector = torch.tensor(
                [
                    math.cos(elevation) * math.cos(azimuth),
                    math.cos(elevation) * math.sin(azimuth),
                    math.sin(elevation),
                ]
            ).double()
            farthest_m = float((scene.places_m @ normal_vector).max())
            starts += [
                {
                    "azimuth_rad": azimuth,
                    "elevation_rad": elevation,
                    "distance_m": farthest_m + gap * scene.reach_m,
                }
                for gap in (0.3, 1.0)
            ]
        low_m, high_m = scene.sensor_places_m.min(0).values, scene.sensor_places_m.max(0).values
        for axis, (azimuth, elevation) in enumerate(((0.0, 0.0), (QUARTER_TURN, 0.0), (0.0, QUARTER_TURN))):
            extent_m = float(high_m[axis] - low_m[axis])
            if extent_m > LEAST_BETWEEN * scene.reach_m:
                starts += [
                    {
                        "azimuth_rad": azimuth,
                        "elevation_rad": elevation,
                        "distance_m": float(low_m[axis]) + share * extent_m,
                    }
                    for share in BETWEEN
                ]
        return tuple(starts)

    def response(
        self, per_ampere: PerAmpere, points_m: Float[Tensor, "*#batch place 3"], theta: Theta
    ) -> Float[Tensor, "*#batch place 3"]:
        """In front the image of the coil, behind so much less of its field.

        A thin sheet of iron that reflects the share r lets 1 - r pass: then the field along the sheet is the same on both sides.
        References: Jackson, Classical Electrodynamics, 3rd ed., section 5.17 (image), 5.8 (continuity).
        """
        azimuth, elevation = theta["azimuth_rad"], theta["elevation_rad"]
        across = torch.stack(
            (
                torch.cos(elevation) * torch.cos(azimuth),
                torch.cos(elevation) * torch.sin(azimuth),
                torch.sin(elevation),
            ),
            dim=-1,
        )[..., None, :]
        depth_m = ((points_m * across).sum(-1) - theta["distance_m"][..., None])[..., None]
        coil_m = ((per_ampere.position_m * across).sum(-1) - theta["distance_m"][..., None])[..., None]
        is_behind = depth_m * coil_m < 0.0
        field = per_ampere.at(torch.where(is_behind, points_m, points_m - 2.0 * depth_m * across))
        turned = field - 2.0 * (field * across).sum(-1, keepdim=True) * across
        return -theta["strength"][..., None, None] * torch.where(is_behind, field, turned)


class IronBody(RoomEffect):
    """A small piece of soft iron is magnetised by the coils and answers as a dipole."""

    name: ClassVar[str] = "iron_body"
    words: ClassVar[str] = "a piece of iron in the room answers the coils"
    source: ClassVar[str] = "a ball of iron of radius a has 4 pi a^3 / mu0: tools and screws of 1 to 5 cm"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Radius cubed of an equivalent ball of iron, and where it lies in the world."""
        ends = 8.0 * extent.reach_m
        return (
            at_least_zero("volume_m3", "m3", (0.3 * extent.reach_m) ** 3),
            *(shape(f"{axis}_m", "m", -ends, ends) for axis in "xyz"),
        )

    def starts(self, scene: Scene, place: str) -> tuple[dict[str, float], ...]:
        """Around the middle of the places, at two distances."""
        middle = scene.places_m.mean(0)
        directions = [
            (x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if (x, y, z) != (0, 0, 0)
        ]
        starts = []
        for direction in directions:
            along = torch.tensor(direction).double()
            along = along / along.norm()
            farthest_m = float(((scene.places_m - middle) @ along).max())
            for gap in (0.4, 1.2):
                point = middle + along * (farthest_m + gap * scene.reach_m)
                starts.append({f"{axis}_m": float(v) for axis, v in zip("xyz", point, strict=True)})
        return tuple(starts)

    def response(
        self, per_ampere: PerAmpere, points_m: Float[Tensor, "*#batch place 3"], theta: Theta
    ) -> Float[Tensor, "*#batch place 3"]:
        """Dipole 4 pi a^3 / mu0 times the coil's field at the body (Jackson, section 5.11)."""
        body_m = torch.stack([theta[f"{axis}_m"] for axis in "xyz"], dim=-1)[..., None, :]
        at_body = per_ampere.at(body_m + torch.zeros_like(points_m))
        r = points_m - body_m
        r2 = (r**2).sum(-1, keepdim=True)
        dipole = (3.0 * r * (r * at_body).sum(-1, keepdim=True) - r2 * at_body) * r2**-2.5
        return theta["volume_m3"][..., None, None] * dipole
