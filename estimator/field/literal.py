"""The paper's sum as printed: spherical components of loops added as if all loops had one centre (eq 13).

Each loop's B_r and B_theta refer to its own centre; the sum takes them along the unit vectors about the centre of the front face.
It is off by 4 to 22 % rms, the more the nearer the workspace (docs/paper.md, errata). Diagnosis uses it to recognise readings made with it.
"""

from __future__ import annotations

from jaxtyping import Float

from estimator.field.loop import loop_terms
from estimator.field.winding import Winding, loops_of
from estimator.field.winding_shape import Rule
from estimator.tensors import Tensor, torch


def literal_field_per_ampere(
    points_coil_m: Float[Tensor, "*#batch point 3"], winding: Winding, rule: Rule
) -> Float[Tensor, "*batch point 3"]:
    """Field of one ampere by the literal sum, in T/A, in the coil frame.

    Args:
        points_coil_m: Points in the coil frame, outside the winding.
        winding: Geometry.
        rule: Quadrature rule that stands for the loops.
    References: Osinde et al., eq 13.
    """
    loops = torch.broadcast_tensors(*loops_of(winding, rule))
    height_m, radius_m, weight = (value.flatten(-2)[..., None, :] for value in loops)
    x, y, z = (points_coil_m[..., i, None] for i in range(3))
    rho = torch.sqrt(x**2 + y**2).clamp(min=1e-12)
    above = z - height_m
    h, axial = loop_terms(x, y, above, radius_m, rule.steps)
    radial = rho * h
    r_loop = torch.sqrt(rho**2 + above**2)
    sin_loop, cos_loop = rho / r_loop, above / r_loop
    b_r = (weight * (radial * sin_loop + axial * cos_loop)).sum(-1)
    b_theta = (weight * (radial * cos_loop - axial * sin_loop)).sum(-1)
    rho, z = rho[..., 0], z[..., 0]
    r = torch.sqrt(rho**2 + z**2)
    b_rho, b_z = (b_r * rho + b_theta * z) / r, (b_r * z - b_theta * rho) / r
    return torch.stack((x[..., 0] / rho * b_rho, y[..., 0] / rho * b_rho, b_z), dim=-1)
