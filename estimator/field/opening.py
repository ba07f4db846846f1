"""Field through a round opening in a wide sheet of soft iron."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

RING = math.sqrt(0.4)  # of the radius: where a field that rises as the square has its mean over the opening


def through_opening(
    from_middle_m: Float[Tensor, "*#batch place 3"],
    towards_source: Float[Tensor, "*#batch #place 3"],
    radius_m: Float[Tensor, "*#batch"],
    mean_T: Float[Tensor, "*#batch #place"],
    middle_T: Float[Tensor, "*#batch #place"],
) -> Float[Tensor, "*batch place 3"]:
    """What a round opening adds to the field in front of a perfect sheet (source and image) and behind it (nothing).

    Soft iron is at one magnetic potential. An opening adds a potential that vanishes on the sheet, is the same on both sides, and has the
    slope in the opening that makes the flux through it continuous: the electrostatics of a conducting sheet with a hole, closed in oblate
    spheroidal coordinates where the source's field is uniform in the opening. Here it may also rise as the square of the distance from
    the middle, which adds the third harmonic of these coordinates; changes around the opening are averaged.

    Args:
        from_middle_m: Points from the middle of the opening, anywhere but on its rim.
        towards_source: Unit vector across the sheet.
        radius_m: Of the opening.
        mean_T: Field of the source alone along `towards_source`, averaged over the opening with the weight that decides on the field far
            behind it: its mean on the ring of `RING` times the radius.
        middle_T: The same in the middle of the opening.
    Returns:
        Field in the frame of the points.
    References: Jackson, Classical Electrodynamics, 3rd ed., section 3.13 (uniform field); Sneddon, Mixed Boundary Value Problems in
        Potential Theory, 1966, chapter 3 (the dual integral equations, from which the second term follows).

    In the opening, the flux of source and image behind the sheet (none) and in front of it (twice the source's) meet half way:

    >>> import torch
    >>> at, up = torch.tensor([[[0.01, 0.0, 1e-9]], [[0.0, 0.0, 1.0]]], dtype=torch.float64)
    >>> one = torch.ones(1, dtype=torch.float64)
    >>> round(through_opening(at, up, 0.2 * one[0], one, one)[0, 2].item(), 6)
    -1.0
    """
    height_m = (from_middle_m * towards_source).sum(-1)
    beside_m = from_middle_m - height_m[..., None] * towards_source
    radius_m = radius_m[..., None]
    height = height_m.abs() / radius_m
    xi, eta = _oblate((beside_m**2).sum(-1) / radius_m**2, height)
    turn = torch.atan2(torch.ones_like(xi), xi)
    first, first_slope = 1.0 - xi * turn, xi / (1.0 + xi**2) - turn
    third = 1.0 + 3.75 * xi**2 - 0.75 * (5.0 * xi**3 + 3.0 * xi) * turn
    third_slope = (
        7.5 * xi - 0.75 * (15.0 * xi**2 + 3.0) * turn + 0.75 * (5.0 * xi**3 + 3.0 * xi) / (1.0 + xi**2)
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
    square: Float[Tensor, "*batch place"], height: Float[Tensor, "*batch place"]
) -> tuple[Tensor, Tensor]:
    """Oblate spheroidal coordinates of a distance squared from the axis and a height, in units of the opening's radius.

    height = xi eta and square = (1 + xi^2) (1 - eta^2); the larger of the two by its root, the other from their product, so that neither
    loses digits near the opening.
    """
    excess = height**2 + square - 1.0
    larger = torch.sqrt(0.5 * (torch.sqrt(excess**2 + 4.0 * height**2) + excess.abs()))
    smaller = height / larger
    is_outside = excess > 0.0
    return torch.where(is_outside, larger, smaller), torch.where(is_outside, smaller, larger)
