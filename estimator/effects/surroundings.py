"""Fields of the room that are there without current."""

from __future__ import annotations

from typing import ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.effects.base import Quantity, Theta, triple
from estimator.effects.circumstances import Circumstances, Extent
from estimator.effects.stages import RoomEffect


class BackgroundField(RoomEffect):
    """A uniform field of the room, such as the Earth's."""

    name: ClassVar[str] = "background_field"
    words: ClassVar[str] = "a constant field of the room adds to that of the coils"
    source: ClassVar[str] = "the Earth's field, 25 to 65 uT (IGRF-13)"
    is_background: ClassVar[bool] = True

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Components in the world frame."""
        return triple("xyz", "_T", "T", 50e-6)

    def steady_T(
        self, points_m: Float[Tensor, "*#batch pose 3"], theta: Theta
    ) -> Float[Tensor, "*#batch pose 3"]:
        """The same everywhere."""
        field = torch.stack([theta[f"{axis}_T"] for axis in "xyz"], dim=-1)[..., None, :]
        return field.expand(*field.shape[:-2], points_m.shape[-2], 3)


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
