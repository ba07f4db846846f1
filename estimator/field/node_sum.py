"""Field of the weighted loops of a quadrature rule at many points, with derivatives of any order or with the first ones only.

Almost all computing time is spent here. Numbers without derivatives go through machine code (`field.kernel`), all others through torch.
"""

from __future__ import annotations

from enum import Enum, auto
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from estimator.field.first_order import carrying_slopes
from estimator.field.kernel import SMALLEST_RHO2_M2, field_and_slopes, slopes_of_loops, sum_of_loops
from estimator.field.loop import loop_derivatives, loop_terms
from estimator.field.machine_code import is_plain, pays
from estimator.tensors import Tensor, torch


class Nodes(NamedTuple):
    """Weighted loops that stand for a winding, on any number of node axes; heights and radii broadcast to the weights."""

    height_m: Float[Tensor, " rows *#node"]
    radius_m: Float[Tensor, " rows *#node"]
    weight: Float[Tensor, " rows *node"]

    def flat(self) -> Nodes:
        """These loops along one axis."""
        return Nodes(*(value.flatten(1) for value in torch.broadcast_tensors(*self)))


class SumMode(Enum):
    """How loops are summed.

    Attributes:
        PLAIN: Derivatives of any order; none cost nothing.
        FIRST_ORDER: First derivatives in many directions at low cost; no second ones.
    """

    PLAIN = auto()
    FIRST_ORDER = auto()


def sum_over_nodes(
    points_m: Float[Tensor, "rows point 3"], nodes: Nodes, steps: int
) -> Float[Tensor, "rows point 3"]:
    """Field per ampere of weighted loops about z, row by row.

    Args:
        points_m: Points in the coil frame.
        nodes: Height, radius and weight of the loops of every row.
        steps: AGM steps of each loop.
    """
    if pays(points_m.shape[1] * nodes.weight.numel()) and is_plain(points_m, *nodes):
        return sum_of_loops(points_m, *nodes.flat(), steps)
    # Points run along the last axis, which vector instructions need to be long; loops run along the axes before it.
    height, radius, weight = (value[..., None] for value in nodes)
    before_points = (1,) * (weight.ndim - 2)
    x, y, z = (coordinate.unflatten(0, (-1, *before_points)) for coordinate in points_m.unbind(-1))
    h, axial = loop_terms(x, y, z - height, radius, steps)
    h_sum, axial_sum = ((weight * value).flatten(1, -2).sum(1) for value in (h, axial))
    return torch.stack((points_m[..., 0] * h_sum, points_m[..., 1] * h_sum, axial_sum), dim=-1)


def sum_to_first_order(
    points_m: Float[Tensor, "rows point 3"], nodes: Nodes, steps: int
) -> Float[Tensor, "rows point 3"]:
    """Field per ampere of weighted loops, in T/A, with first derivatives in points and nodes, but without second ones.

    Forward-mode differentiation of `sum_over_nodes` carries every direction through every loop. Here each loop is evaluated once, with its
    own derivatives, and only their sums at each point are carried along the directions.

    Args:
        points_m, nodes, steps: As in `sum_over_nodes`.
    """
    height, radius, weight = nodes.flat()
    of_each = loop_slopes(points_m.detach(), height.detach(), radius.detach(), steps)
    fixed_weight = weight.detach()
    sums = (fixed_weight[:, None, None] @ of_each[:, :, :2])[..., 0, :]  # factor, row, value and slope, point
    if is_plain(height, radius, weight):  # a winding that nothing changes
        return carrying_first_order(points_m, sums)
    # Both are zero and carry derivatives.
    drop, growth = fixed_weight * (height.detach() - height), fixed_weight * (radius - radius.detach())
    by_node = torch.cat((weight - fixed_weight, drop, growth), dim=-1)[:, None]
    return carrying_first_order(points_m, sums, (by_node @ of_each.flatten(2, 3))[..., 0, :])


def carrying_first_order(
    points_m: Float[Tensor, "*#batch point 3"],
    sums: Float[Tensor, "2 *#batch 2 point"],
    changes: Float[Tensor, "2 *#batch point"] | None = None,
) -> Float[Tensor, "*batch point 3"]:
    """Field of loops about z from its two factors, h and axial, with their first derivatives in the points.

    Args:
        points_m: Points in the coil frame.
        sums: The factors, each with its derivative along z, without derivatives of their own.
        changes: Of the factors; zero, and they carry derivatives in something else.
    """
    fixed_m = points_m.detach()
    if is_plain(fixed_m, sums):
        batch = np.broadcast_shapes(fixed_m.shape[:-2], sums.shape[1:-2])
        fixed = fixed_m.expand(*batch, *fixed_m.shape[-2:]).reshape(-1, *fixed_m.shape[-2:])
        value, slopes = field_and_slopes(
            fixed, sums.expand(2, *batch, *sums.shape[-2:]).reshape(2, -1, *sums.shape[-2:])
        )
        value, slopes = value.reshape(*batch, *value.shape[1:]), slopes.reshape(*batch, *slopes.shape[1:])
    else:
        value, slopes = field_and_slopes_by_torch(fixed_m[..., :2], sums)
    field = carrying_slopes(value, slopes, points_m)
    return field if changes is None else field + _field(fixed_m[..., :2], *changes)


def field_and_slopes_by_torch(
    across_m: Float[Tensor, "*#batch point 2"], sums: Float[Tensor, "2 *#batch 2 point"]
) -> tuple[Float[Tensor, "*batch point 3"], Float[Tensor, "*batch point 3 3"]]:
    """`field.kernel.field_and_slopes`, for numbers of any kind."""
    (h, h_slope), (axial, axial_slope) = (factor.unbind(-2) for factor in sums)
    # div B = 0 gives the derivative of h in rho^2, curl B = 0 that of axial.
    h_rho2 = -(h + 0.5 * axial_slope) / across_m.square().sum(-1).clamp(min=SMALLEST_RHO2_M2)
    bent = 2.0 * h_rho2[..., None] * across_m
    slopes = torch.stack(
        (
            bent[..., 0] * across_m[..., 0] + h,
            bent[..., 0] * across_m[..., 1],
            h_slope * across_m[..., 0],
            bent[..., 1] * across_m[..., 0],
            bent[..., 1] * across_m[..., 1] + h,
            h_slope * across_m[..., 1],
            h_slope * across_m[..., 0],
            h_slope * across_m[..., 1],
            axial_slope,
        ),
        dim=-1,
    ).unflatten(-1, (3, 3))
    return _field(across_m, h, axial), slopes


def _field(
    across_m: Float[Tensor, "*#batch point 2"],
    h: Float[Tensor, "*#batch point"],
    axial: Float[Tensor, "*#batch point"],
) -> Float[Tensor, "*batch point 3"]:
    """Field of the two factors at points with such coordinates across the axis."""
    return torch.cat((across_m * h[..., None], axial[..., None]), dim=-1)


def loop_slopes(
    points_m: Float[Tensor, "rows point 3"],
    height_m: Float[Tensor, "rows node"],
    radius_m: Float[Tensor, "rows node"],
    steps: int,
) -> Float[Tensor, "2 rows 3 node point"]:
    """The two factors of each loop's field: each with its derivatives along z and in the radius."""
    if is_plain(points_m, height_m, radius_m):
        return slopes_of_loops(points_m, height_m, radius_m, steps)
    height, radius = height_m[..., None], radius_m[..., None]
    x, y, z = (coordinate[:, None] for coordinate in points_m.unbind(-1))
    above = z - height
    h, axial, h_z, axial_z = torch.broadcast_tensors(*loop_derivatives(x, y, above, radius, steps))
    # Derivatives in the radius: h and axial are homogeneous of degree -2 and -1 in all lengths, and obey the field laws.
    h_a = (axial_z - above * h_z) / radius
    axial_a = -(axial + (x * x + y * y) * h_z + above * axial_z) / radius
    return torch.stack((torch.stack((h, h_z, h_a), 1), torch.stack((axial, axial_z, axial_a), 1)))
