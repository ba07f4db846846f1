"""Field of the weighted loops of a quadrature rule at many points, summed eagerly, compiled, or with first derivatives.

Almost all computing time is spent here. Compiled by torch the sum takes about 4 ns a loop instead of 34 ns, but the first call of a process
costs seconds (20 s the first time on a machine; torch keeps its cache on disk). Only long sampling compiles it. Without a C++ compiler the
eager sum takes its place.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from enum import Enum, auto
from functools import cache
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.field.loop import loop_derivatives, loop_terms

_log = logging.getLogger(__name__)

SMALLEST_RHO2_M2 = 1e-30  # square of the distance to the axis; nearer, a derivative in it has no effect
USUAL_STEPS = (
    4  # AGM steps some centimetres from the coil; code is compiled for this number, and anew for any other
)


class Nodes(NamedTuple):
    """Weighted loops that stand for a winding, on any number of node axes; heights and radii broadcast to the weights."""

    height_m: Float[Tensor, " rows *#node"]
    radius_m: Float[Tensor, " rows *#node"]
    weight: Float[Tensor, " rows *node"]

    def flat(self) -> Nodes:
        """The same loops along one axis."""
        return Nodes(*(value.flatten(1) for value in torch.broadcast_tensors(*self)))


NodeSum = Callable[[Tensor, Nodes, int], Tensor]


class SumMode(Enum):
    """How loops are summed.

    Attributes:
        EAGER: Starts at once; has derivatives of any order.
        COMPILED: For many calls; has no derivatives.
        FIRST_ORDER: First derivatives in many directions at low cost; no second ones.
    """

    EAGER = auto()
    COMPILED = auto()
    FIRST_ORDER = auto()


def sum_over_nodes(
    points_m: Float[Tensor, "rows point 3"], nodes: Nodes, steps: int
) -> Float[Tensor, "rows point 3"]:
    """Field per ampere of weighted loops about z, row by row.

    Points run along the last axis, which vector instructions need to be long; loops run along the axes before it.

    Args:
        points_m: Points in the coil frame.
        nodes: Height, radius and weight of the loops of every row.
        steps: AGM steps of each loop.
    """
    height, radius, weight = (value[..., None] for value in nodes)
    before_points = (1,) * (weight.ndim - 2)
    x, y, z = (coordinate.unflatten(0, (-1, *before_points)) for coordinate in points_m.unbind(-1))
    h, axial = loop_terms(x, y, z - height, radius, steps)
    h_sum, axial_sum = ((weight * value).flatten(1, -2).sum(1) for value in (h, axial))
    return torch.stack((points_m[..., 0] * h_sum, points_m[..., 1] * h_sum, axial_sum), dim=-1)


def sum_to_first_order(
    points_m: Float[Tensor, "rows point 3"], nodes: Nodes, steps: int
) -> Float[Tensor, "rows point 3"]:
    """The same sum with exact value and first derivatives in points and nodes, but without second ones.

    Forward-mode differentiation of `sum_over_nodes` carries every direction through every loop. Here each loop is evaluated once, with its
    own derivatives, and only their sums at each point are carried along the directions.

    Args:
        points_m, nodes, steps: As in `sum_over_nodes`.
    """
    fixed_points_m = points_m.detach()
    height, radius, weight = (value.detach()[..., None] for value in nodes)
    before_points = (1,) * (weight.ndim - 2)
    x, y, z = (coordinate.unflatten(0, (-1, *before_points)) for coordinate in fixed_points_m.unbind(-1))
    above = z - height
    h, axial, h_z, axial_z = torch.broadcast_tensors(*loop_derivatives(x, y, above, radius, steps))
    # Derivatives in the radius: h and axial are homogeneous of degree -2 and -1 in all lengths, and obey the field laws below.
    h_a = (axial_z - above * h_z) / radius
    axial_a = -(axial + (x * x + y * y) * h_z + above * axial_z) / radius
    h, axial, h_z, axial_z, h_a, axial_a = (
        value.flatten(1, -2) for value in torch.broadcast_tensors(h, axial, h_z, axial_z, h_a, axial_a)
    )
    height, radius, weight = (value.flatten(1) for value in torch.broadcast_tensors(*nodes))
    fixed_weight = weight.detach()
    # Both are zero and carry derivatives.
    drop, growth = fixed_weight * (height.detach() - height), fixed_weight * (radius - radius.detach())
    by_node = torch.cat((weight, drop, growth), dim=-1)[:, None]
    h_sum = (by_node @ torch.cat((h, h_z, h_a), dim=1))[:, 0]
    axial_sum = (by_node @ torch.cat((axial, axial_z, axial_a), dim=1))[:, 0]
    h_value, h_slope, axial_slope = ((fixed_weight[..., None] * value).sum(1) for value in (h, h_z, axial_z))
    rho2 = fixed_points_m[..., :2].square().sum(-1)
    # div B = 0 gives the derivative of h in rho^2, curl B = 0 that of axial.
    h_rho2 = -(h_value + 0.5 * axial_slope) / rho2.clamp(min=SMALLEST_RHO2_M2)
    # Steps in z and rho^2; again zero, with derivatives.
    step_m = points_m - fixed_points_m
    step_z, step_rho2 = step_m[..., 2], 2.0 * (fixed_points_m[..., :2] * step_m[..., :2]).sum(-1)
    h_sum = h_sum + h_slope * step_z + h_rho2 * step_rho2
    axial_sum = axial_sum + axial_slope * step_z + 0.5 * h_slope * step_rho2
    return torch.stack((points_m[..., 0] * h_sum, points_m[..., 1] * h_sum, axial_sum), dim=-1)


@cache
def compiled_sum() -> NodeSum:
    """The compiled sum, or the eager one if this machine cannot compile; tried once per process."""
    try:
        compiled: NodeSum = torch.compile(sum_over_nodes, dynamic=True)
        with torch.no_grad():
            compiled(*_trial())
    except Exception as error:  # a broken compiler or too new a Python raises many types
        _log.warning("the field sum is not compiled on this machine and runs about 4 times slower: %s", error)
        return sum_over_nodes
    return compiled


def _trial() -> tuple[Tensor, Nodes, int]:
    """Arguments to compile with. All sizes differ, also from the 3 of a vector: the compiler assumes that equal sizes stay equal."""
    points_m = torch.ones(2, 5, 3, dtype=torch.float64)
    nodes = Nodes(*(torch.full((2, 7), 0.5, dtype=torch.float64) for _ in range(3)))
    return points_m, nodes, USUAL_STEPS
