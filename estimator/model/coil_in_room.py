"""One coil as seen from the room: what iron and conductors of the room answer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from jaxtyping import Float

from estimator.effects.stages import PerAmpere
from estimator.frames import Transform
from estimator.tensors import Tensor


@dataclass(frozen=True)
class CoilInRoom(PerAmpere):
    """One coil as seen from the room, at every distinct pose.

    Attributes:
        world_from_coil: Its pose.
        field_per_ampere: At points of the coil frame.
    """

    world_from_coil: Transform
    field_per_ampere: Callable[[Tensor], Tensor]

    @property
    def position_m(self) -> Float[Tensor, "*#batch #pose 3"]:
        """Position of the coil in the world frame, in m."""
        return self.world_from_coil.translation_m

    def at(self, points_m: Float[Tensor, "*#batch pose 3"]) -> Float[Tensor, "*batch pose 3"]:
        """Field per ampere in the world frame at one point per pose."""
        return self.world_from_coil.rotate(
            self.field_per_ampere(self.world_from_coil.inverse().apply(points_m))
        )

    def at_each(self, points_m: Float[Tensor, "*#batch point 3"]) -> Float[Tensor, "*batch pose point 3"]:
        """Field per ampere in the world frame at points that stand still, for every pose."""
        pose = self.world_from_coil
        pose = Transform(pose.rotation[..., None, :, :], pose.translation_m[..., None, :])
        points_coil_m = pose.inverse().apply(points_m[..., None, :, :])
        field = self.field_per_ampere(points_coil_m.flatten(-3, -2))
        return pose.rotate(field.unflatten(-2, points_coil_m.shape[-3:-1]))
