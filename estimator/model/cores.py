"""The iron cores of a rig's coils, which answer all windings and each other.

Every pattern of every core (`field.core`) stands in one small system of equations for each pose. What moves apart is computed for every
pose, what stands still once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from estimator.effects.circumstances import Circumstances
from estimator.effects.stages import CoreMagnetisation, CoreMemory
from estimator.effects.use import uses_of
from estimator.field.coil import field_of_coil
from estimator.field.core import (
    BANDS,
    HEIGHTS,
    PATTERNS,
    Core,
    demagnetisation,
    field_of_core,
    share_of_heights,
)
from estimator.field.first_order import first_order_field
from estimator.field.node_sum import SumMode
from estimator.field.saturation import polarisation_T
from estimator.field.winding import Winding
from estimator.field.winding_shape import Rule
from estimator.frames import Transform
from estimator.model.bodies import winding_of
from estimator.rig.bodies import Coil, WoundCoil
from estimator.rig.coordinates import Values
from estimator.rig.rig import Rig
from estimator.tensors import Tensor, torch

MOST_AXIAL_NODES, MOST_RADIAL_NODES, STEPS = 12, 3, 7  # of a winding as its core sees it: error 1e-4


@dataclass(frozen=True)
class CoreInRoom:
    """One core.

    Attributes:
        coil: Its coil, and the number of that among the rig's coils.
        core: Its shape and its iron.
        world_from_coil: Pose of the coil, by row or one for all.
    """

    coil: Coil
    index: int
    core: Core
    world_from_coil: Transform

    @property
    def axis_m(self) -> Float[Tensor, "*batch 1 height 3"]:
        """Points of the axis at the core's heights, in the coil frame."""
        heights_m = self.core.heights_m
        zero = torch.zeros_like(heights_m)
        return torch.stack((zero, zero, heights_m), dim=-1)[..., None, :, :]

    def field_at(
        self, points_coil_m: Float[Tensor, "*#batch point 3"], is_first_order: bool
    ) -> Float[Tensor, "*batch point pattern 3"]:
        """Flux density of each pattern at points of the coil frame, per tesla."""
        sizes = (self.core.radius_m, self.core.length_m, self.core.front_m)
        if not is_first_order:
            return field_of_core(points_coil_m, *sizes)

        def field(points_m: Tensor, numbers: Sequence[Tensor]) -> Tensor:
            return field_of_core(points_m, *numbers).flatten(-2)

        return first_order_field(field, points_coil_m, sizes).unflatten(-1, (PATTERNS, 3))


@dataclass(frozen=True)
class Cores:
    """All cores of a rig, with the windings at the poses of some rows.

    Attributes:
        members: The cores.
        per_ampere: mu0 H of one ampere in each coil for every pattern of every core.
        demagnetisation: mu0 H of the patterns on each other, against them.
        lags_A: By coil, what its core takes its current for, less that current.
    """

    members: tuple[CoreInRoom, ...]
    per_ampere: Float[Tensor, "*#batch #row pattern coil"]
    demagnetisation: Float[Tensor, "*#batch #row pattern pattern"]
    lags_A: Mapping[int, Float[Tensor, "*#batch reading"]]

    @classmethod
    def of(
        cls,
        rig: Rig,
        values: Values,
        world_from_coil: Mapping[str, Transform],
        circumstances: Circumstances,
        is_first_order: bool,
    ) -> Cores:
        """The cores at some values.

        Args:
            rig: Has cores.
            values: Every number of the rig.
            world_from_coil: Pose of every coil that has a winding.
            circumstances: Of the readings.
            is_first_order: Second derivatives may be missing.
        """
        names = [coil.name for coil in rig.coils]
        members = tuple(
            CoreInRoom(rig.round[k], names.index(use.place), use.effect.core(use.theta(values)), pose)
            for use in uses_of(rig, CoreMagnetisation)
            for k, pose in [(use.index(rig.round), world_from_coil[use.place])]
        )
        mode = SumMode.FIRST_ORDER if is_first_order else SumMode.PLAIN
        drives, rows = [], []
        for core in members:
            by_coil = dict.fromkeys(names, core.core.radius_m.new_zeros(PATTERNS))
            for coil in rig.wound:
                by_coil[coil.name] = _drive(rig, values, core, coil, world_from_coil[coil.name], mode)
            drives.append(torch.stack(torch.broadcast_tensors(*by_coil.values()), dim=-1))
            blocks = [_coupling(core, other, is_first_order) for other in members]
            rows.append(_joined(blocks, dim=-1))
        lags_A = {}
        for use in uses_of(rig, CoreMemory):
            number = use.index(rig.coils)
            lags_A[number] = use.effect.lag_A(use.theta(values), circumstances, number)
        return cls(members, _joined(drives, dim=-2), _joined(rows, dim=-2), lags_A)

    def polarisations_T(
        self, current_A: Float[Tensor, "*#batch #reading coil"], pose_row: Int[Tensor, " reading"] | None
    ) -> list[Float[Tensor, "*batch #reading pattern"]]:
        """Polarisation of each core's patterns.

        Args:
            current_A: That flows in the coils.
            pose_row: Row of each reading; None where every reading has the row of its own number.
        """
        per_ampere, matrix = (
            self._by_reading(value, pose_row) for value in (self.per_ampere, self.demagnetisation)
        )
        applied = []
        for i, core in enumerate(self.members):
            seen_A = current_A
            if core.index in self.lags_A:
                is_own = (torch.arange(current_A.shape[-1], device=current_A.device) == core.index).to(
                    current_A.dtype
                )
                seen_A = current_A + self.lags_A[core.index][..., None] * is_own
            own = per_ampere[..., i * PATTERNS : (i + 1) * PATTERNS, :]
            applied.append((own @ seen_A[..., None])[..., 0])
        strengths = torch.broadcast_tensors(*(core.core.strength for core in self.members))
        strength = torch.stack(strengths, dim=-1).repeat_interleave(PATTERNS, dim=-1)
        limits = torch.broadcast_tensors(*(1.0 / core.core.saturation_T for core in self.members))
        limit_per_T = torch.stack([limit[..., None] * _is_along(limit) for limit in limits], dim=-2).flatten(
            -2
        )
        polarisation = polarisation_T(
            _joined(applied, dim=-1), matrix, strength[..., None, :], limit_per_T[..., None, :]
        )
        return list(polarisation.split(PATTERNS, dim=-1))

    def _by_reading(self, value: Tensor, pose_row: Tensor | None) -> Tensor:
        """A matrix of each row as every reading has it."""
        return value if pose_row is None or value.shape[-3] == 1 else value[..., pose_row, :, :]


def _drive(
    rig: Rig, values: Values, core: CoreInRoom, source: WoundCoil, world_from_source: Transform, mode: SumMode
) -> Float[Tensor, "*batch #row pattern"]:
    """mu0 H of one ampere in a coil for each pattern of a core.

    A pattern that fans out feels the field along the axis as it is at the core's surface. The own winding has it there, between the wire
    and the axis; that of another coil hardly varies across the core.
    """
    winding = winding_of(rig, source, values)
    nominal = rig.nominal_values()
    rule = Rule(
        min(MOST_AXIAL_NODES, round(nominal[f"{source.name}.axial_loops"])),
        min(MOST_RADIAL_NODES, round(nominal[f"{source.name}.radial_loops"])),
        STEPS,
    )
    if source is core.coil:
        surface_m = torch.minimum(core.core.radius_m, 0.9 * _bore_m(winding_of(rig, core.coil, values)))[
            ..., None
        ]
        heights_m = core.core.heights_m
        surface_m, heights_m = torch.broadcast_tensors(surface_m, heights_m)
        points_m = torch.stack((surface_m, torch.zeros_like(heights_m), heights_m), dim=-1)
        along = field_of_coil(source, winding, rule, mode)(points_m)[..., 2]
        across = torch.zeros_like(along[..., :2])
        return torch.cat((along, across), dim=-1)[..., None, :]
    source_from_coil = world_from_source.inverse() @ core.world_from_coil
    each = _with_points(source_from_coil)
    at_m = each.apply(core.axis_m)
    field = field_of_coil(source, winding, rule, mode)(at_m.flatten(-3, -2)).unflatten(-2, at_m.shape[-3:-1])
    return _on_patterns(each.unrotate(field))


def _coupling(
    core: CoreInRoom, other: CoreInRoom, is_first_order: bool
) -> Float[Tensor, "*batch #row pattern pattern"]:
    """mu0 H of each pattern of a core, or of itself, against each pattern of a core."""
    if other is core:
        return demagnetisation(core.core.radius_m, core.core.length_m)[..., None, :, :]
    other_from_coil = _with_points(other.world_from_coil.inverse() @ core.world_from_coil)
    at_m = other_from_coil.apply(core.axis_m)
    per_T = other.field_at(at_m.flatten(-3, -2), is_first_order).unflatten(-3, at_m.shape[-3:-1])
    turned = _with_points(other_from_coil).unrotate(per_T)
    return -_on_patterns(turned.movedim(-2, -3)).mT


def _on_patterns(field: Float[Tensor, "*batch height 3"]) -> Float[Tensor, "*batch pattern"]:
    """Field along the axis at each height, and its mean across."""
    share = share_of_heights(field)[:, None] / BANDS
    return torch.cat((field[..., 2], (field[..., :2] * share).sum(-2)), dim=-1)


def _is_along(like: Tensor) -> Float[Tensor, " pattern"]:
    """1 for patterns along the axis, which saturate; across it, demagnetisation leaves little field to saturate with."""
    return (torch.arange(PATTERNS, device=like.device) < HEIGHTS).to(like.dtype)


def _bore_m(winding: Winding) -> Tensor:
    return winding.radius_m - winding.thickness_m


def _with_points(pose: Transform) -> Transform:
    """Poses with one more axis for points, after the rows."""
    return Transform(pose.rotation[..., None, :, :], pose.translation_m[..., None, :])


def _joined(values: Sequence[Tensor], dim: int) -> Tensor:
    """Concatenated along one of the last two axes, broadcast along the others."""
    others = np.broadcast_shapes(*(value.movedim(dim, -1).shape[:-1] for value in values))
    return torch.cat(
        [value.movedim(dim, -1).expand(*others, value.shape[dim]) for value in values], dim=-1
    ).movedim(-1, dim)
