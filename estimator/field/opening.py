"""Field through a round opening in a wide sheet of soft iron."""

from __future__ import annotations

import math

from jaxtyping import Float

from estimator.tensors import Tensor, torch

# Radius of the ring, over that of the opening: there a field that rises as the square equals its weighted mean over the opening.
RING = math.sqrt(0.4)


def through_opening(
    from_middle_m: Float[Tensor, "*#batch point 3"],
    towards_source: Float[Tensor, "*#batch #point 3"],
    radius_m: Float[Tensor, "*#batch"],
    mean_T: Float[Tensor, "*#batch #point"],
    middle_T: Float[Tensor, "*#batch #point"],
) -> Float[Tensor, "*batch point 3"]:
    """What a round opening adds to the field in front of a perfect sheet (source and image) and behind it (none).

    Soft iron is a magnetic equipotential. An opening adds a potential that vanishes on the sheet, is the same on both sides, and has the
    slope in the opening that makes the flux through it continuous. This is the electrostatics of a conducting sheet with a hole. It has a
    closed form in oblate spheroidal coordinates if the source's field is uniform in the opening. Here the field may also rise as the square
    of the distance from the middle, which adds the third harmonic of these coordinates; its variation around the opening is averaged.

    Args:
        from_middle_m: Points from the middle of the opening, anywhere but on its rim.
        towards_source: Unit normal of the sheet, towards the source.
        radius_m: Radius of the opening.
        mean_T: Field of the source alone along `towards_source`, averaged over the opening with the weight that determines the field far
            behind it: its mean on the ring of `RING` times the radius.
        middle_T: The same component in the middle of the opening.
    Returns: Field in the frame of the points.
    References: Jackson, Classical Electrodynamics, 3rd ed., section 3.13 (uniform field); Sneddon, Mixed Boundary Value Problems in
        Potential Theory, 1966, chapter 3 (the dual integral equations, from which the second term follows).

    In the opening, the normal field lies half-way between that behind the sheet (none) and in front of it (twice the source's):

    >>> import torch
    >>> point_m, normal = torch.tensor([[[0.01, 0.0, 1e-9]], [[0.0, 0.0, 1.0]]], dtype=torch.float64)
    >>> radius_m, source_T = torch.tensor(0.2, dtype=torch.float64), torch.ones(1, dtype=torch.float64)
    >>> round(through_opening(point_m, normal, radius_m, source_T, source_T)[0, 2].item(), 6)
    -1.0
    """
    height_m = (from_middle_m * towards_source).sum(-1)
    beside_m = from_middle_m - height_m[..., None] * towards_source
    radius_m = radius_m[..., None]
    height = height_m.abs() / radius_m
    xi, eta = _oblate((beside_m**2).sum(-1) / radius_m**2, height)
    arccot = torch.atan2(torch.ones_like(xi), xi)
    first, first_slope = 1.0 - xi * arccot, xi / (1.0 + xi**2) - arccot
    third = 1.0 + 3.75 * xi**2 - 0.75 * (5.0 * xi**3 + 3.0 * xi) * arccot
    third_slope = (
        7.5 * xi - 0.75 * (15.0 * xi**2 + 3.0) * arccot + 0.75 * (5.0 * xi**3 + 3.0 * xi) / (1.0 + xi**2)
    )
    rise_T = 4.0 / 9.0 * (middle_T - mean_T)
    along_xi = mean_T * eta * first_slope + rise_T * 0.5 * (5.0 * eta**3 - 3.0 * eta) * third_slope
    along_eta = mean_T * first + rise_T * 1.5 * (5.0 * eta**2 - 1.0) * third
    scale = 2.0 / math.pi / (xi**2 + eta**2)
    across_T = scale * (eta * (1.0 + xi**2) * along_xi + xi * (1.0 - eta**2) * along_eta)
    beside_T_per_m = scale / radius_m * (xi * along_xi - eta * along_eta)
    side = torch.where(height_m < 0.0, -1.0, 1.0)
    return (side * across_T)[..., None] * towards_source + beside_T_per_m[..., None] * beside_m


def _oblate(
    square: Float[Tensor, "*batch point"], height: Float[Tensor, "*batch point"]
) -> tuple[Tensor, Tensor]:
    """Oblate spheroidal coordinates xi, eta of a squared distance from the axis and a height, in units of the opening's radius.

    height = xi eta and square = (1 + xi^2) (1 - eta^2). The larger one comes from the quadratic equation, the other from their product, so
    that neither loses digits near the opening.
    """
    excess = height**2 + square - 1.0
    larger = torch.sqrt(0.5 * (torch.sqrt(excess**2 + 4.0 * height**2) + excess.abs()))
    smaller = height / larger
    is_outside = excess > 0.0
    return torch.where(is_outside, larger, smaller), torch.where(is_outside, smaller, larger)
