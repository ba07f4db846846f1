"""Fields of the room that are there without current."""

from __future__ import annotations

import math
from typing import ClassVar

from jaxtyping import Float

from estimator.effects.base import WHEN, Quantity, Theta, shape, since, triple
from estimator.effects.circumstances import Circumstances, Extent
from estimator.effects.stages import RoomEffect
from estimator.tensors import Tensor, torch

MOST_FREQUENCIES = 320  # as of corrections that swing in time
# Slopes of a field, in the order of its numbers; zz is what leaves no divergence.
SLOPES = ("xx", "yy", "xy", "xz", "yz")


class BackgroundField(RoomEffect):
    """A uniform field of the room, such as the Earth's."""

    name: ClassVar[str] = "background_field"
    words: ClassVar[str] = "a constant field of the room adds to that of the coils"
    source: ClassVar[str] = "the Earth's field, 25 to 65 uT (IGRF-13)"
    is_background: ClassVar[bool] = True
    is_everywhere: ClassVar[bool] = True

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Components in the world frame."""
        return triple("xyz", "_T", "T", 50e-6)

    def steady_T(
        self, points_m: Float[Tensor, "*#batch pose 3"], theta: Theta
    ) -> Float[Tensor, "*#batch pose 3"]:
        """Field of the room in the world frame, in T, the same at every point."""
        field = torch.stack([theta[f"{axis}_T"] for axis in "xyz"], dim=-1)[..., None, :]
        return field.expand(*field.shape[:-2], points_m.shape[-2], 3)


class BackgroundGradient(RoomEffect):
    """The field of the room is not the same everywhere: it changes steadily across the room, as far from a magnet or from steel.

    Where no current flows its divergence and curl vanish, so the matrix of its slopes is symmetric and has no trace: five numbers.
    """

    name: ClassVar[str] = "background_gradient"
    words: ClassVar[str] = "the constant field of the room differs from place to place"
    source: ClassVar[str] = "steel benches, cupboards and magnets some metres off: 10 to 500 uT/m"
    is_background: ClassVar[bool] = True

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Change of the first component along the second axis in the world frame; the field is that beyond the one at the origin."""
        return triple(SLOPES, "_T_per_m", "T/m", 200e-6)

    def steady_T(
        self, points_m: Float[Tensor, "*#batch pose 3"], theta: Theta
    ) -> Float[Tensor, "*#batch pose 3"]:
        """Proportional to the distance from the origin."""
        xx, yy, xy, xz, yz = (theta[f"{key}_T_per_m"] for key in SLOPES)
        rows = ((xx, xy, xz), (xy, yy, yz), (xz, yz, -xx - yy))
        slopes = torch.stack([torch.stack(row, dim=-1) for row in rows], dim=-2)
        return points_m @ slopes


class BackgroundDrift(RoomEffect):
    """The field of the room changes steadily."""

    name: ClassVar[str] = "background_drift"
    words: ClassVar[str] = "the field of the room drifts"
    source: ClassVar[str] = "lifts, trams and magnets next door: some 10 uT within a session"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Change per hour in the world frame, from the beginning of the session on."""
        return triple("xyz", "_T_per_h", "T/h", 50e-6 / extent.duration_h)

    def drifting_T(self, theta: Theta, circumstances: Circumstances) -> Float[Tensor, "*#batch reading 3"]:
        """Proportional to the time since the session began."""
        rate = torch.stack([theta[f"{axis}_T_per_h"] for axis in "xyz"], dim=-1)
        return rate[..., None, :] * circumstances.hours[:, None]


class BackgroundStep(RoomEffect):
    """From one instant on the field of the room is another, everywhere alike."""

    name: ClassVar[str] = "background_step"
    words: ClassVar[str] = "from one instant on the field of the room is another"
    source: ClassVar[str] = "a steel door or a chair that was moved, a magnet that was put down: 1 to 50 uT"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Components in the world frame, and the time since the session began from which on they are there."""
        return (*triple("xyz", "_T", "T", 50e-6), since(extent))

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Instants with readings before and after."""
        return tuple({"since_h": instant_h} for instant_h in circumstances.instants_h)

    def beyond_the_moment(self, key: str) -> str | None:
        """An instant needs a session to lie in."""
        return WHEN

    def drifting_T(self, theta: Theta, circumstances: Circumstances) -> Float[Tensor, "*#batch reading 3"]:
        """Step of the room's field in the world frame, in T; 0 before the instant."""
        field_T = torch.stack([theta[f"{axis}_T"] for axis in "xyz"], dim=-1)
        return field_T[..., None, :] * circumstances.is_meanwhile(theta)[..., None]


class PeriodicInterference(RoomEffect):
    """The field of the room swings with a period of its own, everywhere alike.

    On a regular clock, a swing faster than half a cycle between readings looks like a slower one; frequencies stop there. They also stop at
    160 cycles in a session (320 starts): farther apart than half a cycle in a session, starts would miss swings between them.
    """

    name: ClassVar[str] = "periodic_interference"
    words: ClassVar[str] = "the field of the room swings periodically"
    source: ClassVar[str] = "mains and machines nearby, 1 to 50 uT; their beat with the clock of the readings"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Cosine and sine part of each component in the world frame, from the beginning of the session on, and the frequency."""
        spacing, n = extent.frequencies_per_h(MOST_FREQUENCIES)
        return (
            *(
                q
                for part in ("cos", "sin")
                for q in triple([f"{part}_{axis}" for axis in "xyz"], "_T", "T", 20e-6)
            ),
            shape("frequency_per_h", "1/h", 0.5 * spacing, (n + 0.5) * spacing),
        )

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Frequencies from half a cycle per session on, half a cycle apart."""
        spacing, n = circumstances.extent.frequencies_per_h(MOST_FREQUENCIES)
        return tuple({"frequency_per_h": (i + 1) * spacing} for i in range(n))

    def drifting_T(
        self, theta: Theta, circumstances: Circumstances
    ) -> Float[Tensor, "*#batch reading 3"] | None:
        """Swinging field of the room in the world frame, in T; None where a single moment stands for a session, which has no phase."""
        if circumstances.is_moment:
            return None
        angle = 2.0 * math.pi * theta["frequency_per_h"][..., None] * circumstances.hours
        cos_T, sin_T = (
            torch.stack([theta[f"{part}_{axis}_T"] for axis in "xyz"], dim=-1)[..., None, :]
            for part in ("cos", "sin")
        )
        return cos_T * torch.cos(angle)[..., None] + sin_T * torch.sin(angle)[..., None]
