"""Fields of windings of any shape: round ones by the sum that the rig file selects, those with straight sides by theirs."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from jaxtyping import Float

from estimator.field.literal import literal_field_per_ampere
from estimator.field.node_sum import SumMode
from estimator.field.sided import (
    SidedWinding,
    choose_sided_rule,
    distance_to_sided,
    sided_field_per_ampere,
)
from estimator.field.straight import segment_field
from estimator.field.winding import (
    DEFAULT_TOLERANCE,
    Rule,
    Winding,
    choose_rule,
    distance_to_winding,
    field_of_loops,
    loops_of,
)
from estimator.rig.rig import Coil, FieldSum, Leads, WoundCoil
from estimator.tensors import Tensor, torch

AnyWinding = Winding | SidedWinding


def coil_field_per_ampere(
    coil: WoundCoil,
    points_coil_m: Float[Tensor, "*#batch point 3"],
    winding: AnyWinding,
    rule: Rule,
    mode: SumMode = SumMode.PLAIN,
) -> Float[Tensor, "*batch point 3"]:
    """Field of one ampere in the coil frame, in T/A, with that of its leads.

    Args:
        coil: `field_sum` of a round one selects the sum: the correct one, or the paper's as printed.
        points_coil_m: Points in the coil frame, outside the winding.
        winding: Geometry.
        rule: Quadrature rule that stands for the loops.
        mode: How loops are summed. The paper's sum ignores it: it always has all derivatives.
    """
    return field_of_coil(coil, winding, rule, mode)(points_coil_m)


def field_of_coil(
    coil: WoundCoil, winding: AnyWinding, rule: Rule, mode: SumMode = SumMode.PLAIN
) -> Callable[[Tensor], Tensor]:
    """Field of one ampere in T/A, with that of the leads, as a function of points in the coil frame.

    The loops that stand for the winding are found once.

    Args:
        coil, winding, rule, mode: As in `coil_field_per_ampere`.
    """
    field: Callable[[Tensor], Tensor]
    if isinstance(winding, SidedWinding):
        field = partial(sided_field_per_ampere, winding=winding, rule=rule, mode=mode)
    elif isinstance(coil, Coil) and coil.field_sum is FieldSum.SPHERICAL_COMPONENTS:
        field = partial(literal_field_per_ampere, winding=winding, rule=rule)
    else:
        field = partial(field_of_loops, loops=loops_of(winding, rule), steps=rule.steps, mode=mode)
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


def distance_to_coil(
    points_coil_m: Float[Tensor, "*#batch point 3"], winding: AnyWinding
) -> Float[Tensor, "*batch point"]:
    """Distance from points of the coil frame to the space that the winding fills; 0 inside it."""
    if isinstance(winding, SidedWinding):
        return distance_to_sided(points_coil_m, winding)
    return distance_to_winding(points_coil_m, winding)


def rule_of_coil(
    winding: AnyWinding, points_coil_m: Float[Tensor, "point 3"], tolerance: float = DEFAULT_TOLERANCE
) -> Rule:
    """The smallest quadrature rule that meets a tolerance at points outside the winding; 0 asks for the full sum."""
    if isinstance(winding, SidedWinding):
        return choose_sided_rule(winding, points_coil_m, tolerance)
    return choose_rule(winding, points_coil_m, tolerance)
