"""Fields of windings of any shape: round ones by the sum that the rig file selects, those with straight sides by theirs."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

from estimator.field.literal import literal_field_per_ampere
from estimator.field.node_sum import SumMode
from estimator.field.sided import (
    SidedWinding,
    choose_sided_rule,
    distance_to_sided,
    sided_field_per_ampere,
)
from estimator.field.winding import (
    DEFAULT_TOLERANCE,
    Rule,
    Winding,
    choose_rule,
    distance_to_winding,
    winding_field_per_ampere,
)
from estimator.rig.rig import Coil, FieldSum, WoundCoil

AnyWinding = Winding | SidedWinding


def coil_field_per_ampere(
    coil: WoundCoil,
    points_coil_m: Float[Tensor, "*#batch point 3"],
    winding: AnyWinding,
    rule: Rule,
    mode: SumMode = SumMode.PLAIN,
) -> Float[Tensor, "*batch point 3"]:
    """Field of one ampere in the coil frame, in T/A.

    Args:
        coil: `field_sum` of a round one selects the sum: the correct one, or the paper's as printed.
        points_coil_m: Points in the coil frame, outside the winding.
        winding: Geometry.
        rule: Quadrature rule that stands for the loops.
        mode: How loops are summed. The paper's sum ignores it: it always has all derivatives.
    """
    if isinstance(winding, SidedWinding):
        return sided_field_per_ampere(points_coil_m, winding, rule, mode)
    if isinstance(coil, Coil) and coil.field_sum is FieldSum.SPHERICAL_COMPONENTS:
        return literal_field_per_ampere(points_coil_m, winding, rule)
    return winding_field_per_ampere(points_coil_m, winding, rule, mode)


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
