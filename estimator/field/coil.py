"""Fields of windings of any shape: round ones by the sum that the rig file selects, those with straight sides by theirs."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from jaxtyping import Float

from estimator.field.literal import literal_field_per_ampere
from estimator.field.node_sum import SumMode
from estimator.field.sided import SidedWinding
from estimator.field.straight import segment_field
from estimator.field.winding import Winding
from estimator.field.winding_shape import Rule
from estimator.rig.bodies import FieldSum, Leads, WoundCoil
from estimator.tensors import Tensor, torch

AnyWinding = Winding | SidedWinding


def field_of_coil(
    coil: WoundCoil, winding: AnyWinding, rule: Rule, mode: SumMode = SumMode.PLAIN
) -> Callable[[Tensor], Tensor]:
    """Field of one ampere in T/A, with that of the leads, as a function of points in the coil frame.

    The loops that stand for the winding are found once. Points lie outside the winding.

    Args:
        coil: `field_sum` of a round one selects the sum: the correct one, or the paper's as printed.
        winding: Geometry.
        rule: Quadrature rule that stands for the loops.
        mode: How loops are summed. The paper's sum ignores it: it always has all derivatives.
    """
    field: Callable[[Tensor], Tensor]
    if coil.field_sum is FieldSum.SPHERICAL_COMPONENTS and isinstance(winding, Winding):
        field = partial(literal_field_per_ampere, winding=winding, rule=rule)
    else:
        field = winding.field_by(rule, mode)
    leads = coil.leads
    return field if leads is None else lambda points_m: field(points_m) + field_of_leads(points_m, leads)


def field_of_leads(
    points_coil_m: Float[Tensor, "*batch point 3"], leads: Leads
) -> Float[Tensor, "*batch point 3"]:
    """Field of one ampere in the leads of a coil in its frame, in T/A; the source of the current closes the circuit elsewhere.

    Args:
        points_coil_m: Points in the coil frame, not on a lead.
        leads: Where the current comes and goes.
    """
    total = torch.zeros_like(points_coil_m)
    for piece in leads.pieces:
        start_m, end_m = torch.tensor(piece, dtype=points_coil_m.dtype, device=points_coil_m.device)
        total = total + segment_field(points_coil_m, start_m, end_m)
    return total
