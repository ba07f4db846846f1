"""Magnetic field of one circular current loop, exact to rounding everywhere outside the wire.

The textbook formula (Simpson et al., NASA 2001; eq 4 of the paper) is a difference of the elliptic integrals K and E that cancels
near the axis and far away, and its radius rho = sqrt(x^2 + y^2) has no derivative on the axis. With

    u = a^2 + z^2 - rho^2,   s = a^2 + z^2 + rho^2,   p^2 = u^2 + 4 rho^2 z^2 = (alpha beta)^2

the first step of the arithmetic-geometric mean (AGM) of alpha and beta starts from sqrt((s + p) / 2) and sqrt(p), K / beta is
pi / (2 AGM), and Legendre's sum over the AGM gives E. Every quantity is then even in rho, so the field is

    (Bx, By) = (x, y) h,   h = mu0 I / (4 M p^2) z (4 a^2 - s t),   Bz = mu0 I / (4 M p^2) (2 a^2 u + rho^2 t (2 z^2 - u))

with M the mean and t = sum 2^(n-1) c_n^2 / rho^2. No term cancels by more than the logarithm of the distance to the wire, and the
derivatives on the axis are those of a smooth function. The derivation is in `docs/explanation/field-model.md`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from jaxtyping import Float

from estimator.tensors import Tensor, torch
from estimator.units import MU0_T_M_PER_A

FEWEST_STEPS = 3
MOST_STEPS = 10


class LoopField(NamedTuple):
    """Field of a loop about +z at height 0: B = (x h, y h, axial), each per ampere."""

    h_T_per_A_m: Float[Tensor, "..."]
    axial_T_per_A: Float[Tensor, "..."]


NEAREST_STEPS = 7  # of the mean, which suffice next to a wire


def loop_terms(
    x_m: Float[Tensor, "..."],
    y_m: Float[Tensor, "..."],
    z_m: Float[Tensor, "..."],
    radius_m: Float[Tensor, "..."],
    steps: int,
) -> LoopField:
    """The two factors of a loop's field. Coaxial loops share x and y, so a winding sums the factors before the last product.

    Args:
        x_m, y_m, z_m: Point in the frame of the loop (centre at 0, axis along z). Broadcast with `radius_m`.
        radius_m: Radius of the loop.
        steps: AGM steps; `agm_steps` gives the number that a distance needs.
    Returns: Infinite or NaN on the wire itself; `winding` refuses such points earlier.
    References: Bulirsch, Numer. Math. 7, 78 (1965) for the AGM form; Osinde et al., eq 4, for the field.
    """
    q, u, s, z2, p2, mean, t = _means(x_m, y_m, z_m, radius_m, steps)
    radius2 = radius_m * radius_m
    common = (0.25 * MU0_T_M_PER_A) / (mean * p2)
    h = torch.addcmul(4.0 * radius2, s, t, value=-1.0) * common * z_m
    axial = torch.addcmul(2.0 * radius2 * u, q * t, 2.0 * z2 - u) * common
    return LoopField(h, axial)


class LoopDerivatives(NamedTuple):
    """The factors of a loop's field and their derivatives along z; all others follow from these (`docs/explanation/field-model.md`)."""

    h_T_per_A_m: Float[Tensor, "..."]
    axial_T_per_A: Float[Tensor, "..."]
    h_z_T_per_A_m2: Float[Tensor, "..."]
    axial_z_T_per_A_m: Float[Tensor, "..."]


def loop_derivatives(
    x_m: Float[Tensor, "..."],
    y_m: Float[Tensor, "..."],
    z_m: Float[Tensor, "..."],
    radius_m: Float[Tensor, "..."],
    steps: int,
) -> LoopDerivatives:
    """The two factors of a loop's field with their derivatives along z, in little more time than the factors alone.

    Args:
        x_m, y_m, z_m, radius_m, steps: As in `loop_terms`.
    References: derivatives of the elliptic integrals, DLMF 19.4; combined in `docs/explanation/field-model.md`.
    """
    q, u, s, z2, p2, mean, t = _means(x_m, y_m, z_m, radius_m, steps)
    radius2 = radius_m * radius_m
    v = 2.0 * z2 - u
    qt = q * t
    inverse = 1.0 / p2
    common = (0.25 * MU0_T_M_PER_A) / mean * inverse
    bracket = 4.0 * radius2 - s * t
    axial = (2.0 * radius2 * u + qt * v) * common
    both, whole = 2.0 * radius2 * u, (2.0 * radius2 * u + v * s) * inverse
    shared = (both * s + 4.0 * v * radius2 * q) * inverse
    along_q = 0.25 * ((2.0 * qt + bracket) * whole + v * t) - 0.5 * shared - 2.0 * radius2 + qt
    along_z2 = 0.5 * qt * whole - 0.5 * shared + 2.0 * radius2 + qt
    axial_q = common * along_q - 2.0 * axial * v * inverse
    axial_z2 = common * along_z2 - axial * (2.0 * u + 4.0 * q) * inverse
    return LoopDerivatives(bracket * common * z_m, axial, 2.0 * axial_q, 2.0 * z_m * axial_z2)


def _means(
    x_m: Float[Tensor, "..."],
    y_m: Float[Tensor, "..."],
    z_m: Float[Tensor, "..."],
    radius_m: Float[Tensor, "..."],
    steps: int,
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]:
    """rho^2, u, s, z^2, p^2, the mean M and t of the module docstring."""
    # Height and radius may vary along different axes: the grouping keeps terms that depend on only one of them small. `lerp` and `addcmul`
    # save passes over the data.
    radius2 = radius_m * radius_m
    z2 = z_m * z_m
    y2 = y_m * y_m
    rho2 = x_m * x_m + y2
    u = (radius_m - x_m) * (radius_m + x_m) - y2 + z2  # this order keeps all digits next to the wire
    s = radius2 + rho2 + z2
    p2 = torch.addcmul(4.0 * rho2 * z2, u, u)
    product = _root(p2)  # of the two numbers that are averaged
    mean2 = torch.lerp(s, product, 0.5)
    mean = _root(mean2)
    t = radius2 / mean2
    square = t / 16.0  # (c_n / rho)^2 / 16, so that c_(n+1) = c_n^2 / (4 mean) needs no factor
    for n in range(1, steps + 1):
        geometric = _root(product)
        product = mean * geometric
        mean = torch.lerp(mean, geometric, 0.5)
        c = square / mean
        square = rho2 * c * c
        t = torch.add(t, square, alpha=2.0 ** (n + 4))
    return rho2, u, s, z2, p2, mean, t


def _root(square: Float[Tensor, "..."]) -> Float[Tensor, "..."]:
    """Square root of positive numbers to 1.5 units in the last place; `torch.sqrt` takes 1.7 times as long on AMD processors."""
    return square * torch.rsqrt(square)


def loop_field(
    points_m: Float[Tensor, "*#batch 3"], radius_m: Float[Tensor, "*#batch"], current_A: float = 1.0
) -> Float[Tensor, "*batch 3"]:
    """Magnetic flux density of one circular loop in the loop's frame, in tesla.

    Args:
        points_m: Points in the frame of the loop (centre at 0, axis along +z).
        radius_m: Radius of the loop, > 0; broadcasts with the points.
        current_A: Current, positive counter-clockwise seen from +z.
    Returns: Bx, By, Bz, as exact as the number format allows: in float64 to 1e-14 of |B|, and near the wire to what the last digit of the
        coordinates changes, 1e-16 radius / distance.
    References: Osinde et al., eq 4; the module docstring gives the form used.
    Examples:
        >>> centre = torch.zeros(3, dtype=torch.float64)
        >>> field_T = loop_field(centre, torch.tensor(0.05, dtype=torch.float64), current_A=2.0)
        >>> bool(abs(field_T[2] - MU0_T_M_PER_A * 2.0 / (2 * 0.05)) < 1e-20)
        True
    """
    x, y, z = points_m.unbind(-1)
    steps = agm_steps(x, y, z, radius_m)
    h, axial = loop_terms(x, y, z, radius_m, steps)
    return current_A * torch.stack((x * h, y * h, axial), dim=-1)


def agm_steps(
    x_m: Float[Tensor, "..."],
    y_m: Float[Tensor, "..."],
    z_m: Float[Tensor, "..."],
    radius_m: Float[Tensor, "..."],
) -> int:
    """AGM steps that the nearest of these points needs for full precision; carries no gradient.

    Examples:
        >>> zero = torch.zeros(1)
        >>> agm_steps(zero, zero, zero, zero + 0.05)
        3
    """
    with torch.no_grad():
        rho = torch.sqrt(x_m * x_m + y_m * y_m)
        ratio2 = ((radius_m - rho) ** 2 + z_m**2) / ((radius_m + rho) ** 2 + z_m**2)
        return steps_for_ratio(math.sqrt(max(float(ratio2.min()), 0.0)) if ratio2.numel() else 1.0)


def steps_for_ratio(ratio: float) -> int:
    """AGM steps after the first until kc = alpha / beta (nearest over farthest distance to the wire) has reached 1.

    Examples:
        >>> steps_for_ratio(0.5), steps_for_ratio(0.05), steps_for_ratio(1e-6)
        (4, 5, 6)
    """
    steps = -1
    while 1.0 - ratio > 1e-8 and steps < MOST_STEPS and ratio > 0.0:
        ratio = 2.0 * math.sqrt(ratio) / (1.0 + ratio)
        steps += 1
    return min(max(steps + 1, FEWEST_STEPS), MOST_STEPS) if ratio > 0.0 else MOST_STEPS
