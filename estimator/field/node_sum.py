"""The inner sum of everything: weighted loops of a quadrature rule at many points, eager, compiled, or with its first derivatives.

Compiled by torch the sum takes about 4 ns a loop instead of 34 ns, but the first call of a process costs seconds (20 s the first time on
a machine; torch keeps its cache on disk). Long sampling asks for it, short jobs never pay for it, and without a C++ compiler the
eager sum does the work.
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

from estimator.field.loop import loop_slope, loop_terms

_log = logging.getLogger(__name__)

LEAST_SQUARE_M2 = 1e-30  # of the distance to the axis: nearer, a derivative in it moves nothing
USUAL_STEPS = 4  # AGM steps of readings some centimetres away; the compiled code is unrolled for them, and compiled anew for others


class Nodes(NamedTuple):
    """Weighted loops that stand for a winding: any number of node axes, to whose product heights and radii broadcast."""

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
        EAGER: At once, with derivatives of any order.
        COMPILED: Many times, without derivatives.
        FIRST_ORDER: With first derivatives in many directions, and without second ones.
    """

    EAGER = auto()
    COMPILED = auto()
    FIRST_ORDER = auto()


def sum_over_nodes(
    points_m: Float[Tensor, "rows point 3"], nodes: Nodes, steps: int
) -> Float[Tensor, "rows point 3"]:
    """Field per ampere of weighted loops about z, row by row.

    Points run along the last axis, where vector instructions want many equal neighbours, and loops along the axes before it.

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
    """The same sum with the right value and first derivatives in points and nodes, and no second ones.

    Forward mode through `sum_over_nodes` carries every direction through every loop. Here the loops are taken once, with their own
    derivatives; what they leave at a point is carried on, however many directions there are.

    Args:
        points_m, nodes, steps: As in `sum_over_nodes`.
    """
    here = points_m.detach()
    height, radius, weight = (value.detach()[..., None] for value in nodes)
    before_points = (1,) * (weight.ndim - 2)
    x, y, z = (coordinate.unflatten(0, (-1, *before_points)) for coordinate in here.unbind(-1))
    lift = z - height
    h, axial, h_z, axial_z = torch.broadcast_tensors(*loop_slope(x, y, lift, radius, steps))
    # In the radius, from the degrees -2 and -1 in which h and axial scale with all lengths, and the laws below.
    h_a = (axial_z - lift * h_z) / radius
    axial_a = -(axial + (x * x + y * y) * h_z + lift * axial_z) / radius
    taken = [value.flatten(1, -2) for value in torch.broadcast_tensors(h, axial, h_z, axial_z, h_a, axial_a)]
    h, axial, h_z, axial_z, h_a, axial_a = taken
    height, radius, weight = (value.flatten(1) for value in torch.broadcast_tensors(*nodes))
    still = weight.detach()
    drop, growth = (
        still * (height.detach() - height),
        still * (radius - radius.detach()),
    )  # zero, with derivatives
    by_node = torch.cat((weight, drop, growth), dim=-1)[:, None]
    h_sum = (by_node @ torch.cat((h, h_z, h_a), dim=1))[:, 0]
    axial_sum = (by_node @ torch.cat((axial, axial_z, axial_a), dim=1))[:, 0]
    h_here, h_slope, axial_slope = ((still[..., None] * value).sum(1) for value in (h, h_z, axial_z))
    square = here[..., :2].square().sum(-1)
    # div B = 0 gives the derivative of h in rho^2, curl B = 0 that of axial.
    h_out = -(h_here + 0.5 * axial_slope) / square.clamp(min=LEAST_SQUARE_M2)
    up = points_m[..., 2] - here[..., 2]
    out = 2.0 * (here[..., :2] * (points_m[..., :2] - here[..., :2])).sum(-1)
    h_sum = h_sum + h_slope * up + h_out * out
    axial_sum = axial_sum + axial_slope * up + 0.5 * h_slope * out
    return torch.stack((points_m[..., 0] * h_sum, points_m[..., 1] * h_sum, axial_sum), dim=-1)


@cache
def compiled_sum() -> NodeSum:
    """The compiled sum, or the eager one where this machine cannot compile; tried once per process."""
    try:
        compiled: NodeSum = torch.compile(sum_over_nodes, dynamic=True)
        with torch.no_grad():
            compiled(*_trial())
    except Exception as error:  # a broken compiler or a too new Python raises one of many types
        _log.warning("the field sum is not compiled on this machine and runs about 4 times slower: %s", error)
        return sum_over_nodes
    return compiled


def _trial() -> tuple[Tensor, Nodes, int]:
    """Arguments to compile with. All sizes differ, also from the 3 of a vector: the compiler takes equal ones for one and the same."""
    points_m = torch.ones(2, 5, 3, dtype=torch.float64)
    nodes = Nodes(*(torch.full((2, 7), 0.5, dtype=torch.float64) for _ in range(3)))
    return points_m, nodes, USUAL_STEPS
