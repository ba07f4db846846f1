"""Field of a coil by the sum that its rig file selects: the correct one, or the paper's as printed."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

from estimator.field.literal import literal_field_per_ampere
from estimator.field.node_sum import SumMode
from estimator.field.winding import Rule, Winding, winding_field_per_ampere
from estimator.rig.rig import Coil, FieldSum


def coil_field_per_ampere(
    coil: Coil,
    points_coil_m: Float[Tensor, "*#batch point 3"],
    winding: Winding,
    rule: Rule,
    mode: SumMode = SumMode.PLAIN,
) -> Float[Tensor, "*batch point 3"]:
    """Field of one ampere in the coil frame, in T/A.

    Args:
        coil: Its `field_sum` selects the sum.
        points_coil_m: Points in the coil frame, outside the winding.
        winding: Geometry.
        rule: Quadrature rule that stands for the loops.
        mode: How loops are summed. The paper's sum ignores it: it always has all derivatives.
    """
    if coil.field_sum is FieldSum.SPHERICAL_COMPONENTS:
        return literal_field_per_ampere(points_coil_m, winding, rule)
    return winding_field_per_ampere(points_coil_m, winding, rule, mode)
