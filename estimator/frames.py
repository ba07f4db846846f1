"""Rigid transforms between the frames of a rig: world, base, flange, coil, sensor.

First step of the measurement model: poses of robots and mounts become one `Transform`, which maps sensor positions
into a coil's frame and fields back out of it. `a_from_b` maps coordinates in frame b to coordinates in frame
a, so neighbours match: ``world_from_coil = world_from_flange @ flange_from_coil``. Everything broadcasts over
leading axes, keeps dtype and device, and is differentiable.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from jaxtyping import Float, Int

from estimator.rotations import rotation_from_vector, turned, turned_back, vector_from_rotation
from estimator.tensors import Tensor, torch

__all__ = [
    "Transform",
    "Triple",
    "in_order",
    "rotation_from_vector",
    "selected",
    "turned",
    "turned_back",
    "vector_from_rotation",
]

Triple: TypeAlias = tuple[float, float, float]


@dataclass(frozen=True)
class Transform:
    """A rigid transform `a_from_b`: rotate, then shift by `translation_m`, the origin of b seen from a.

    Examples:
        >>> position_m, quarter_turn = torch.tensor([[0.0, 0.0, 0.1], [0.0, 0.0, torch.pi / 2]]).double()
        >>> flange_from_coil = Transform.from_pose(position_m, quarter_turn)
        >>> flange_from_coil.apply(torch.tensor([1.0, 2.0, 0.0]).double()).round(decimals=6).tolist()
        [-2.0, 1.0, 0.1]
    """

    rotation: Float[Tensor, "*#batch 3 3"]
    translation_m: Float[Tensor, "*#batch 3"]

    @classmethod
    def identity(cls, dtype: torch.dtype | None = None, device: torch.device | str = "cpu") -> Transform:
        """The transform of a frame to itself, without batch axes, in double precision where no other is named."""
        dtype = dtype or torch.float64
        return cls(torch.eye(3, dtype=dtype, device=device), torch.zeros(3, dtype=dtype, device=device))

    @classmethod
    def from_pose(
        cls, translation_m: Float[Tensor, "*#batch 3"], rotation_vector_rad: Float[Tensor, "*#batch 3"]
    ) -> Transform:
        """Transform from a pose as Universal Robots report it: ``p[x, y, z, rx, ry, rz]``.

        Args:
            translation_m: Origin of the inner frame in the outer frame.
            rotation_vector_rad: Axis times angle, see `rotation_from_vector`.
        Returns: outer_from_inner, over the broadcast of both leading shapes.
        """
        rotation = rotation_from_vector(rotation_vector_rad)
        translation_m = translation_m + torch.zeros_like(rotation_vector_rad)  # broadcasts
        return cls(rotation.expand(*translation_m.shape, 3), translation_m)

    def to_pose(self) -> tuple[Triple, Triple]:
        """Position and rotation vector of the only row, as Universal Robots take them: the inverse of `from_pose`."""
        x_m, y_m, z_m = self.translation_m[0].tolist()
        x_rad, y_rad, z_rad = vector_from_rotation(self.rotation)[0].tolist()
        return (x_m, y_m, z_m), (x_rad, y_rad, z_rad)

    def __matmul__(self, other: Transform) -> Transform:
        """Compose transforms: ``a_from_b @ b_from_c = a_from_c``."""
        return Transform(self.rotation @ other.rotation, self.apply(other.translation_m))

    def inverse(self) -> Transform:
        """b_from_a. Uses the transpose, so the rotation must be orthonormal."""
        return Transform(self.rotation.mT, -self.unrotate(self.translation_m))

    def rows(self, index: Int[Tensor, " row"]) -> Transform:
        """Select rows of the last batch axis; an axis of length 1, which broadcasts, stays as it is."""
        rotation, translation_m = self.rotation, self.translation_m
        return Transform(
            rotation if rotation.shape[-3] == 1 else rotation[..., index, :, :],
            translation_m if translation_m.shape[-2] == 1 else translation_m[..., index, :],
        )

    def shifted(self, offset_m: Float[Tensor, "*#batch #row 3"]) -> Transform:
        """Pose at points off the origin of b, given in b, with the same orientation."""
        return Transform(self.rotation, self.apply(offset_m))

    def sharing_rotation(self) -> Transform:
        """These poses, with a single row of rotations where all are turned alike, as under pure translations.

        Matrix products over rows then happen once: a third of the time of a prediction that is short otherwise.
        """
        first = self.rotation[:1]
        return Transform(first, self.translation_m) if bool((self.rotation == first).all()) else self

    def apply(self, points_m: Float[Tensor, "*#batch 3"]) -> Float[Tensor, "*#batch 3"]:
        """Coordinates in a of points given in b."""
        return self.rotate(points_m) + self.translation_m

    def locate(self, points_m: Float[Tensor, "*#batch 3"]) -> Float[Tensor, "*#batch 3"]:
        """Coordinates in b of points given in a; cheaper than to compose the inverse with poses of the points."""
        return self.unrotate(points_m - self.translation_m)

    def rotate(self, vectors: Float[Tensor, "*#batch 3"]) -> Float[Tensor, "*#batch 3"]:
        """Components in a of free vectors (fields, displacements) given in b."""
        return turned(self.rotation, vectors)

    def unrotate(self, vectors: Float[Tensor, "*#batch 3"]) -> Float[Tensor, "*#batch 3"]:
        """Components in b of free vectors given in a: the transposed rotation."""
        return turned_back(self.rotation, vectors)


def selected(poses: Sequence[Transform], which: Int[Tensor, "*batch row"]) -> Transform:
    """The pose of the given number at every row."""
    rotation, translation_m = poses[0].rotation, poses[0].translation_m
    for i, pose in enumerate(poses[1:], start=1):
        is_this = which == i
        rotation = torch.where(is_this[..., None, None], pose.rotation, rotation)
        translation_m = torch.where(is_this[..., None], pose.translation_m, translation_m)
    return Transform(rotation, translation_m)


def in_order(poses: Sequence[Transform], rows: Sequence[Int[Tensor, "..."]]) -> Transform:
    """Poses at the rows that each belongs to, in the order of the rows, which together are all."""
    batch = np.broadcast_shapes(*(pose.translation_m.shape[:-2] for pose in poses))
    order = torch.cat(list(rows)).argsort()
    rotations = [pose.rotation.expand(*batch, len(own), 3, 3) for pose, own in zip(poses, rows, strict=True)]
    places_m = [pose.translation_m.expand(*batch, len(own), 3) for pose, own in zip(poses, rows, strict=True)]
    return Transform(torch.cat(rotations, -3)[..., order, :, :], torch.cat(places_m, -2)[..., order, :])
