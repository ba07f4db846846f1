"""Force between two coils, each as a single circle with all its turns."""

from __future__ import annotations

import math

from jaxtyping import Float

from estimator.field.loop import NEAREST_STEPS, loop_terms
from estimator.tensors import Tensor, torch

N_POINTS = 64  # on the circle that feels the force; the sum over them converges geometrically


def force_on_loop_N(
    loop_from_other: tuple[Float[Tensor, "*#pose 3"], Float[Tensor, "*#pose 3 3"]],
    radius_m: Float[Tensor, ""],
    other_radius_m: Float[Tensor, ""],
) -> Float[Tensor, "*pose 3"]:
    """Force on a circular loop by another one with an ampere in each, in the frame of the first.

    Both lie about z at height 0 of their own frames, with currents the same way round. The force goes with the product of the currents, and
    of the numbers of turns.

    Args:
        loop_from_other: Middle of the other loop in the frame of the first, in m, and rotation from its frame.
        radius_m, other_radius_m: Radii.
    References: Jackson, Classical Electrodynamics, 3rd ed., eq 5.7 (force on a current in a field).

    Examples:
        Coaxial loops with equal currents attract each other.

        >>> one = torch.ones(())
        >>> force_on_loop_N((torch.tensor([0.0, 0.0, 1.0]), torch.eye(3)), one, one)[2] > 0.0
        tensor(True)
    """
    middle_m, rotation = loop_from_other
    angle = torch.arange(N_POINTS, dtype=radius_m.dtype, device=radius_m.device) * (2.0 * math.pi / N_POINTS)
    zero = torch.zeros_like(angle)
    outward = torch.stack((torch.cos(angle), torch.sin(angle), zero), dim=-1)
    along = torch.stack((-torch.sin(angle), torch.cos(angle), zero), dim=-1)
    seen_m = (radius_m * outward - middle_m[..., None, :]) @ rotation
    x_m, y_m, z_m = seen_m.unbind(-1)
    field = loop_terms(x_m, y_m, z_m, other_radius_m, NEAREST_STEPS)
    field_T = torch.stack((x_m * field.h_T_per_A_m, y_m * field.h_T_per_A_m, field.axial_T_per_A), dim=-1)
    field_T = field_T @ rotation.mT
    step_m = 2.0 * math.pi / N_POINTS * radius_m
    return step_m * torch.linalg.cross(along.expand_as(field_T), field_T).sum(-2)
