"""Fields of a winding of another shape: smooth displacements of the loops, around them and along the coil."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.diagnosis import policy
from estimator.diagnosis.structure.smooth import legendre
from estimator.field.winding import Winding

N_AROUND, N_ALONG = 32, 4  # wire elements around and along the winding


def shape_fields(
    points_coil_m: Float[Tensor, "reading 3"], winding: Winding
) -> Float[Tensor, "reading column 3"]:
    """Fields in the coil frame of radial and axial displacements of the loops: waves around times polynomials along the axis.

    To first order, a wire element dl that is displaced by d adds a dipole of moment d x dl. The winding is taken as a sheet of its mean
    radius. Columns decrease with the number of waves and the degree; their scale is arbitrary.

    Args:
        points_coil_m: In front of the coil, farther away than the distance between loops.
        winding: One, without a batch.
    References: Jackson, Classical Electrodynamics, 3rd ed., section 5.6 (field of a dipole).
    """
    radius_m = winding.radius_m - 0.5 * winding.radial_pitch_m * winding.radial_loops
    phi = 2.0 * math.pi * torch.arange(N_AROUND, dtype=torch.float64, device=points_coil_m.device) / N_AROUND
    along = torch.linspace(-1.0, 1.0, 2 * N_ALONG + 1, dtype=torch.float64, device=points_coil_m.device)[1::2]
    phi, along = (grid.flatten() for grid in torch.meshgrid(phi, along, indexing="ij"))
    zeros, ones = torch.zeros_like(phi), torch.ones_like(phi)
    outward = torch.stack((torch.cos(phi), torch.sin(phi), zeros), dim=-1)
    forward = torch.stack((-torch.sin(phi), torch.cos(phi), zeros), dim=-1)
    upward = torch.stack((zeros, zeros, ones), dim=-1)
    height_m = -0.5 * winding.length_m * (1.0 - along)
    elements_m = radius_m * outward + height_m[:, None] * upward
    waves = [ones]
    for m in range(1, policy.WINDING_WAVES + 1):
        waves += [torch.cos(m * phi) / (1 + m), torch.sin(m * phi) / (1 + m)]
    patterns = torch.einsum(
        "sw,sp->wps", torch.stack(waves, dim=-1), legendre(along, policy.WINDING_DEGREE)
    ).flatten(0, 1)
    moments = torch.cat(
        [patterns[:, :, None] * torch.linalg.cross(shift, forward) for shift in (outward, upward)]
    )
    arm = (points_coil_m[:, None, :] - elements_m) / radius_m
    r = arm.norm(dim=-1)[..., None, None]
    per_moment = (
        3.0 * arm[..., :, None] * arm[..., None, :] / r**5
        - torch.eye(3, dtype=torch.float64, device=points_coil_m.device) / r**3
    )
    fields: Tensor = moments.flatten(1) @ per_moment.flatten(1, 2)  # one product for all columns
    return fields / len(phi)
