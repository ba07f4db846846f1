"""Field of a winding with straight sides: rectangular loops, or racetracks whose corners are arcs.

The coil frame is that of a round winding (`field.winding`): it sits on the front face, +z points away from the coil, and the winding fills
-axial_pitch N_a <= z <= 0. The bore has sides along x and y about the axis, and layers lie outside each other. The loops of a layer keep
the radial pitch from those of the next one all around, so arcs grow with the layers; sharp corners stay sharp in all of them.

The straight parts have a closed form (`field.straight`); arcs are integrated by the rule of Gauss and Legendre.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from estimator.derivatives import value_and_jacobian
from estimator.field.first_order import carrying_slopes, first_order_field
from estimator.field.machine_code import is_plain
from estimator.field.node_sum import SumMode
from estimator.field.quadrature import arcs_of, discrete_gauss
from estimator.field.sided_kernel import slopes_of_sided_loops, sum_of_sided_loops
from estimator.field.straight import MU0_OVER_4PI, along_wire
from estimator.field.winding_shape import Rule, WindingShape
from estimator.tensors import Tensor, torch

ELEMENTS_PER_CHUNK = 1_000_000  # numbers that torch holds at once in between
ALL_DIGITS = 1e-15
# Far away the arcs cancel sides and each other, so that the error is larger relative to what is left.
SPARE_POINTS = 4
MOST_ARC_POINTS = 200  # all digits down to a distance of 7 % of the largest corner radius
QUARTER = 0.5 * math.pi
# Around a section of straight sides its contour is followed at these places, over half the sides: middles, corners, and between.
EDGES = ((1.0, 0.0), (1.0, 0.5), (1.0, 1.0), (0.5, 1.0), (0.0, 1.0))
DIAGONAL = math.sqrt(0.5)
AWAY = (  # in which directions from the middle of the section: along its sides and from its corners
    *((1.0, 0.0), (DIAGONAL, DIAGONAL), (0.0, 1.0), (-DIAGONAL, DIAGONAL)),
    *((-1.0, 0.0), (-DIAGONAL, -DIAGONAL), (0.0, -1.0), (DIAGONAL, -DIAGONAL)),
)


@dataclass(frozen=True)
class SidedWinding(WindingShape):
    """Geometry of a winding with straight sides; every number may carry a batch.

    Attributes:
        is_rounded: Whether corners are arcs.
        side_x_m, side_y_m: Sides of the bore, along x and y.
        corner_radius_m: Of the bore, where corners are round; 0 where they are sharp.
        axial_loops, radial_loops, axial_pitch_m, radial_pitch_m: As in `Winding`; counts may be real numbers.
    """

    is_rounded: bool
    side_x_m: Float[Tensor, "*batch"]
    side_y_m: Float[Tensor, "*batch"]
    corner_radius_m: Float[Tensor, "*batch"]
    axial_loops: Float[Tensor, "*batch"]
    radial_loops: Float[Tensor, "*batch"]
    axial_pitch_m: Float[Tensor, "*batch"]
    radial_pitch_m: Float[Tensor, "*batch"]

    @property
    def kind(self) -> tuple[bool, ...]:
        """Whether corners are arcs."""
        return (self.is_rounded,)

    @property
    def half_width_m(self) -> Float[Tensor, "*batch"]:
        """Half the longer side, and the layers."""
        return 0.5 * torch.maximum(self.side_x_m, self.side_y_m) + self.thickness_m

    def distance_m(self, points_coil_m: Float[Tensor, "*#batch point 3"]) -> Float[Tensor, "*batch point"]:
        """Distance from points to the space that the winding fills; 0 inside it."""
        return distance_to_sided(points_coil_m, self)

    def full_rule(self, points_coil_m: Float[Tensor, "*batch point 3"]) -> Rule:
        """The rule that sums all loops of a winding with whole loop counts, with arcs to all digits."""
        return full_sided_rule(self, points_coil_m)

    def field_by(self, rule: Rule, mode: SumMode = SumMode.PLAIN) -> Callable[[Tensor], Tensor]:
        """Field of one ampere by a rule, in T/A, as a function of points in the coil frame."""
        return partial(sided_field_per_ampere, winding=self, rule=rule, mode=mode)

    def contour_m(self, distance_m: float) -> Float[Tensor, "point 3"]:
        """Points at one distance, around the section in the middle of a side, in a corner, and between."""
        half_m = torch.stack((self.side_x_m, self.side_y_m)) / 2.0
        across = torch.tensor(EDGES, dtype=torch.float64)
        outwards = (across == 1.0).to(torch.float64)
        outwards = outwards / outwards.norm(dim=1, keepdim=True)
        corner_m = (1.0 - math.sqrt(0.5)) * self.corner_radius_m * (across == 1.0).all(1)[:, None]
        middle_m = across * half_m - corner_m + 0.5 * self.thickness_m * outwards
        away = torch.tensor(AWAY, dtype=torch.float64)
        sizes_m = torch.stack((self.thickness_m, self.length_m))
        beside_m, height_m = (0.5 * sizes_m * away.sign() + distance_m * away).unbind(-1)
        height_m = height_m - 0.5 * self.length_m
        flat_m = middle_m[:, None] + beside_m[:, None] * outwards[:, None]
        points_m = torch.cat((flat_m, height_m.expand(len(EDGES), -1)[..., None]), dim=-1).flatten(0, 1)
        is_there = self.distance_m(points_m) > 0.5 * distance_m
        return points_m[is_there]


class SidedLoops(NamedTuple):
    """Weighted loops that stand for a winding, on a grid of axial and radial nodes after the batch.

    Attributes:
        height_m: Of each row.
        half_x_m, half_y_m: Half the distance of opposite sides, in each layer.
        corner_radius_m: Of each layer; 0 where corners are sharp.
        weight: Of each loop.
    """

    height_m: Float[Tensor, "*batch axial 1"]
    half_x_m: Float[Tensor, "*batch 1 radial"]
    half_y_m: Float[Tensor, "*batch 1 radial"]
    corner_radius_m: Float[Tensor, "*batch 1 radial"]
    weight: Float[Tensor, "*batch axial radial"]


def sided_field_per_ampere(
    points_coil_m: Float[Tensor, "*#batch point 3"],
    winding: SidedWinding,
    rule: Rule,
    mode: SumMode = SumMode.PLAIN,
) -> Float[Tensor, "*batch point 3"]:
    """Field of one ampere in the winding at points of the coil frame, in T/A.

    Args:
        points_coil_m: Points in the coil frame, outside the winding.
        winding: Geometry; its batch broadcasts with the points' batch.
        rule: Axial and radial nodes, and in `steps` the points along each arc (`choose_rule`).
        mode: How loops are summed (`node_sum`).
    Returns: Bx, By, Bz in the coil frame per ampere; the current runs counter-clockwise seen from +z.
    References: Jackson, Classical Electrodynamics, 3rd ed., section 5.2 (Biot and Savart).
    Examples: In the middle of a square loop of side L the field is 2 sqrt(2) mu0 I / (pi L).
        >>> side_m, one, pitch_m = torch.tensor([0.098, 1.0, 2e-3], dtype=torch.float64)
        >>> square = SidedWinding(False, side_m, side_m, 0.0 * one, one, one, pitch_m, pitch_m)  # one loop of 100 mm, 1 mm behind
        >>> middle_m = torch.tensor([[0.0, 0.0, -0.001]], dtype=torch.float64)
        >>> round(sided_field_per_ampere(middle_m, square, Rule(1, 1, 0))[0, 2].item() * 1e6, 6)
        11.313708
    """
    if not winding.is_rounded:
        rule = replace(rule, steps=0)
    if is_plain(points_coil_m, *winding.numbers):
        return _in_machine_code(points_coil_m, sided_loops_of(winding, rule), rule.steps)
    if mode is SumMode.PLAIN:
        return _by_torch(points_coil_m, sided_loops_of(winding, rule), rule.steps)
    return _to_first_order(points_coil_m, winding, rule)


def sided_loops_of(winding: SidedWinding, rule: Rule) -> SidedLoops:
    """The weighted loops that stand for a winding."""
    axial = discrete_gauss(winding.axial_loops, rule.axial_nodes)
    radial = discrete_gauss(winding.radial_loops, rule.radial_nodes)
    height_m = winding.axial_pitch_m[..., None] * axial.nodes - 0.5 * winding.length_m[..., None]
    outwards_m = 0.5 * winding.thickness_m[..., None] + winding.radial_pitch_m[..., None] * radial.nodes
    half_x_m, half_y_m = (
        0.5 * side_m[..., None] + outwards_m for side_m in (winding.side_x_m, winding.side_y_m)
    )
    corner_m = winding.corner_radius_m[..., None] + (
        outwards_m if winding.is_rounded else torch.zeros_like(outwards_m)
    )
    weight = axial.weights[..., :, None] * radial.weights[..., None, :]
    x_m, y_m, radius_m = (value[..., None, :] for value in (half_x_m, half_y_m, corner_m))
    return SidedLoops(height_m[..., :, None], x_m, y_m, radius_m, weight)


def full_sided_rule(winding: SidedWinding, points_coil_m: Float[Tensor, "*batch point 3"]) -> Rule:
    """The rule that sums all loops of a winding with whole loop counts, with arcs to all digits.

    The integrand along an arc is analytic up to the complex angle i d / r, with d the distance of the nearest point and r the radius. The
    error of n points falls as rho^(-2 n), with rho the sum of the semi-axes of the ellipse of Bernstein through that angle.
    References: Trefethen, SIAM Review 50, 67 (2008), theorem 4.5.
    """
    axial, radial = (int(count.max().item()) for count in (winding.axial_loops, winding.radial_loops))
    if not winding.is_rounded:
        return Rule(axial, radial, 0)
    with torch.no_grad():
        half_cell_m = 0.5 * float(torch.minimum(winding.axial_pitch_m, winding.radial_pitch_m).min())
        nearest_m = max(float(distance_to_sided(points_coil_m, winding).min()), 0.1 * half_cell_m)
        outermost_m = float((winding.corner_radius_m + winding.thickness_m).max())
    n = math.log(1.0 / ALL_DIGITS) / (2.0 * math.asinh(nearest_m / outermost_m / (0.5 * QUARTER)))
    return Rule(axial, radial, min(math.ceil(n) + SPARE_POINTS, MOST_ARC_POINTS))


def distance_to_sided(
    points_coil_m: Float[Tensor, "*#batch point 3"], winding: SidedWinding
) -> Float[Tensor, "*batch point"]:
    """Distance from points to the space that the winding fills; 0 inside it."""
    z_m = points_coil_m[..., 2]
    thickness_m = winding.thickness_m[..., None]
    beyond_bore_m = _beyond(points_coil_m, winding, torch.zeros_like(thickness_m))
    beyond_all_m = _beyond(points_coil_m, winding, thickness_m)
    across = torch.maximum(-beyond_bore_m, beyond_all_m).clamp(min=0.0)
    axial = torch.maximum(-winding.length_m[..., None] - z_m, z_m).clamp(min=0.0)
    return torch.sqrt(across**2 + axial**2)


def _beyond(points_m: Tensor, winding: SidedWinding, outwards_m: Tensor) -> Float[Tensor, "*batch point"]:
    """Distance from the outline of the bore, moved outwards; negative inside it."""
    corner_m = winding.corner_radius_m[..., None] + (outwards_m if winding.is_rounded else 0.0)
    beside = torch.stack(
        [
            points_m[..., i].abs() - (0.5 * side_m[..., None] + outwards_m - corner_m)
            for i, side_m in enumerate((winding.side_x_m, winding.side_y_m))
        ],
        dim=-1,
    )
    outside: Tensor = beside.clamp(min=0.0).norm(dim=-1)
    return outside + beside.amax(-1).clamp(max=0.0) - corner_m


def _in_machine_code(
    points_m: Float[Tensor, "*#batch point 3"], loops: SidedLoops, arc_points: int
) -> Float[Tensor, "*batch point 3"]:
    each = torch.stack(torch.broadcast_tensors(*loops), dim=-1).flatten(-3, -2)
    batch = np.broadcast_shapes(points_m.shape[:-2], each.shape[:-2])
    points, rows = (_in_rows(value, batch, 2) for value in (points_m, each))
    return sum_of_sided_loops(points, rows, arc_points).reshape(*batch, *points_m.shape[-2:])


def _to_first_order(
    points_m: Float[Tensor, "*#batch point 3"], winding: SidedWinding, rule: Rule
) -> Float[Tensor, "*batch point 3"]:
    """The field with exact value and first derivatives, but without second ones."""

    def loops_at(numbers: Sequence[Tensor]) -> SidedLoops:
        return sided_loops_of(SidedWinding(winding.is_rounded, *numbers), rule)

    fixed = [number.detach() for number in winding.numbers]
    if not is_plain(points_m.detach(), *fixed):

        def field(points_m: Tensor, numbers: Sequence[Tensor]) -> Tensor:
            return _by_torch(points_m, loops_at(numbers), rule.steps)

        return first_order_field(field, points_m, winding.numbers)

    def loops_at_step(step: Tensor) -> Tensor:
        moved = loops_at([number + delta for number, delta in zip(fixed, step, strict=True)])
        return torch.stack(torch.broadcast_tensors(*moved), dim=-1).flatten(-3, -2)

    loops, changes = value_and_jacobian(loops_at_step, points_m.new_zeros(len(fixed)))
    batch = np.broadcast_shapes(points_m.shape[:-2], loops.shape[:-2])
    points, loops, changes = (
        _in_rows(part, batch, n) for part, n in ((points_m.detach(), 2), (loops, 2), (changes, 3))
    )
    parts = slopes_of_sided_loops(points, loops, changes, rule.steps)
    value, slopes = (part.reshape(*batch, *part.shape[1:]) for part in parts)
    return carrying_slopes(value, slopes, points_m, winding.numbers)


def _in_rows(value: Tensor, batch: tuple[int, ...], n_own: int) -> Tensor:
    """A tensor with its batch along one axis, before axes of its own."""
    return value.expand(*batch, *value.shape[-n_own:]).reshape(-1, *value.shape[-n_own:])


def _by_torch(
    points_m: Float[Tensor, "*#batch point 3"], loops: SidedLoops, arc_points: int
) -> Float[Tensor, "*batch point 3"]:
    """Field per ampere of loops with straight sides, in T/A, with derivatives of any order, a part of the points at a time."""
    batch = np.broadcast_shapes(points_m.shape[:-2], loops.weight.shape[:-2])
    at_once = math.prod(batch) * loops.weight.shape[-2:].numel() * 4 * max(arc_points, 1)
    n_parts = math.ceil(points_m.shape[-2] * at_once / ELEMENTS_PER_CHUNK)
    parts = points_m.tensor_split(max(1, min(n_parts, points_m.shape[-2])), dim=-2)
    arcs = torch.from_numpy(arcs_of(arc_points)).to(points_m)
    return torch.cat([sum_by_torch(part, loops, arcs) for part in parts], dim=-2)


def sum_by_torch(
    points_m: Float[Tensor, "*#batch point 3"], loops: SidedLoops, arcs: Float[Tensor, "*#batch node 5"]
) -> Float[Tensor, "*batch point 3"]:
    """Field per ampere of loops with straight sides, in T/A, with derivatives of any order.

    Args:
        points_m: Points in the coil frame.
        loops: Weighted loops that stand for a winding.
        arcs: Points of the arcs (`arcs_of`); none where corners are sharp.
    """
    x, y, z = (points_m[..., i, None, None] for i in range(3))
    height, half_x, half_y, radius, weight = (value[..., None, :, :] for value in loops)
    up = z - height
    along_x, along_y, up2 = half_x - radius, half_y - radius, up**2
    south, north, east, west = y + half_y, half_y - y, half_x - x, x + half_x  # distance from each side
    of_south, of_north = (along_wire(x, away**2 + up2, along_x) for away in (south, north))
    of_east, of_west = (along_wire(y, away**2 + up2, along_y) for away in (east, west))
    field = [
        up * (of_east - of_west),
        up * (of_north - of_south),
        south * of_south + north * of_north + east * of_east + west * of_west,
    ]
    if arcs.shape[-2]:
        of_arcs = _of_arcs((x, y, up), (along_x, along_y, radius), arcs[..., None, None, None, :, :])
        field = [straight + arc for straight, arc in zip(field, of_arcs, strict=True)]
    return MU0_OVER_4PI * torch.stack([(weight * part).sum((-2, -1)) for part in field], dim=-1)


def _of_arcs(
    point_m: tuple[Tensor, Tensor, Tensor], shape_m: tuple[Tensor, Tensor, Tensor], arcs: Tensor
) -> list[Float[Tensor, "*batch point axial radial"]]:
    """4 pi B / mu0 of the four arcs of each loop, in 1/m."""
    x, y, up = (value[..., None] for value in point_m)
    middle_x, middle_y, radius = (value[..., None] for value in shape_m)
    cos, sin, share, right, back = arcs.unbind(-1)
    away_x = x - right * middle_x - radius * cos
    away_y = y - back * middle_y - radius * sin
    scale = share * radius * (away_x**2 + away_y**2 + up**2) ** -1.5
    parts = (scale * cos * up, scale * sin * up, -scale * (sin * away_y + cos * away_x))
    return [part.sum(-1) for part in parts]
