"""Magnetic field of straight wires by the closed integral of Biot and Savart, to rounding everywhere outside the wire.

With a and b from the ends of the wire to the point, the field is mu0 I / 4 pi times (a x b direction) times

    L (|a| + |b|) / (|a| |b| D),   D = |a| |b| + a.b

No term is singular where the wire is only extended, nor where it has no length. Beside the wire a.b is negative and the sum in D cancels:
there D = L^2 rho^2 / (|a| |b| - a.b), with rho the distance from the line.
"""

from __future__ import annotations

import math

from jaxtyping import Float

from estimator.tensors import Tensor, torch
from estimator.units import MU0_T_M_PER_A

MU0_OVER_4PI = MU0_T_M_PER_A / (4.0 * math.pi)


def along_wire(
    along_m: Float[Tensor, "..."], rho2_m2: Float[Tensor, "..."], half_m: Float[Tensor, "..."]
) -> Float[Tensor, "..."]:
    """What the vector from a straight wire to a point, crossed with the wire's direction, is multiplied by: 4 pi B / (mu0 I rho), in 1/m2.

    Args:
        along_m: Distance of the point from the middle of the wire, along it.
        rho2_m2: Square of its distance from the wire's line.
        half_m: Half the length of the wire; a negative one runs the other way.
    References: Hanson and Hirshman, Phys. Plasmas 9, 4410 (2002).
    """
    to_start, to_end = along_m + half_m, along_m - half_m
    a, b = torch.sqrt(to_start**2 + rho2_m2), torch.sqrt(to_end**2 + rho2_m2)
    product, inner = a * b, to_start * to_end + rho2_m2
    is_beside = inner < 0.0
    length = 2.0 * half_m
    apart = length**2 * rho2_m2 / torch.where(is_beside, product - inner, 1.0)
    return length * (a + b) / (product * torch.where(is_beside, apart, product + inner))


def segment_field(
    points_m: Float[Tensor, "*#batch point 3"],
    start_m: Float[Tensor, "*#batch 3"],
    end_m: Float[Tensor, "*#batch 3"],
) -> Float[Tensor, "*batch point 3"]:
    """Field of one ampere in a straight wire, in T.

    Args:
        points_m: Points, not on the wire.
        start_m, end_m: Where the current comes from and goes to; may be the same point.
    References: Hanson and Hirshman, Phys. Plasmas 9, 4410 (2002); Jackson, Classical Electrodynamics, 3rd ed., section 5.2.
    Examples: 1 mm beside the middle of a wire of 2 km, mu0 I / 2 pi rho is 0.2 mT.
        >>> beside, end_m = torch.tensor([[0.0, 1e-3, 0.0], [1e3, 0.0, 0.0]], dtype=torch.float64)
        >>> segment_field(beside[None], -end_m, end_m)[0, 2].item() * 1e3
        0.2
    """
    a, b = points_m - start_m[..., None, :], points_m - end_m[..., None, :]
    r, s = (v.norm(dim=-1, keepdim=True) for v in (a, b))
    along = (end_m - start_m)[..., None, :]
    cross = torch.linalg.cross(*torch.broadcast_tensors(along, a))
    product, inner = r * s, (a * b).sum(-1, keepdim=True)
    is_beside = inner < 0.0
    apart = (cross**2).sum(-1, keepdim=True) / torch.where(is_beside, product - inner, 1.0)
    field: Tensor = cross * (r + s) / (product * torch.where(is_beside, apart, product + inner))
    return MU0_OVER_4PI * field
