"""Static magnetic fields without sources where they are used: gradients of solid harmonics, from outside a ball or from inside one.

Each is free of divergence and curl. Coordinates are in units of the radius of a reference ball, at whose surface every term has rms 1, so
that equal widths of its amplitudes prefer no direction.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache

from jaxtyping import Float, Int

from estimator.tensors import Tensor, torch

Exponents = tuple[int, int, int]
Polynomial = dict[Exponents, float]  # coefficient by powers of x, y and z


def interior_field(
    points: Float[Tensor, "*#batch point 3"], amplitudes: Mapping[int, Float[Tensor, "*#batch term"]]
) -> Float[Tensor, "*batch point 3"]:
    """Field of sources outside the ball.

    Args:
        points: Coordinates about the middle of the ball, in its radius.
        amplitudes: By degree l >= 1 those of its `terms`; degree 1 is uniform.
    References: Jackson, Classical Electrodynamics, 3rd ed., section 3.3 (solid harmonics).
    Examples:
        >>> along_z = {1: torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64)}
        >>> interior_field(torch.zeros(1, 3, dtype=torch.float64), along_z)
        tensor([[0., 0., 1.]], dtype=torch.float64)
    """
    total = torch.zeros_like(points)
    powers = torch.ones_like(points[..., :1])  # monomials of the degree below
    for degree in range(1, max(amplitudes) + 1):
        if degree > 1:
            powers = _raised(points, powers, degree - 1)
        if degree in amplitudes:
            total = total + powers @ _mixed(amplitudes[degree], degree)
    return total


def exterior_field(
    points: Float[Tensor, "*#batch point 3"], amplitudes: Mapping[int, Float[Tensor, "*#batch term"]]
) -> Float[Tensor, "*batch point 3"]:
    """Field of sources inside the ball, about its middle: degree 1 is a dipole, 2 a quadrupole.

    Args:
        points: As in `interior_field`; the middle itself is singular.
        amplitudes: By degree l >= 1 those of its `terms`.
    References: Jackson, Classical Electrodynamics, 3rd ed., section 4.1 (multipole expansion).
    """
    total = torch.zeros_like(points)
    r2 = points.square().sum(-1, keepdim=True)
    for degree, amplitude in amplitudes.items():
        inner = interior_field(points, {degree: amplitude})
        along = (points * inner).sum(-1, keepdim=True) * points / r2  # p (p . grad R) / r^2
        outer = inner - (2.0 + 1.0 / degree) * along
        total = total + math.sqrt(degree / (degree + 1.0)) * outer * r2 ** (-degree - 0.5)
    return total


def gradients(points: Float[Tensor, "point 3"], degree: int) -> Float[Tensor, "point term 3"]:
    """The terms of one degree one by one."""
    each = torch.eye(2 * degree + 1, dtype=points.dtype, device=points.device)
    return interior_field(points, {degree: each}).movedim(0, 1)


@lru_cache
def monomials(degree: int) -> tuple[Exponents, ...]:
    """Powers of x, y and z of that total degree."""
    return tuple((i, j, degree - i - j) for i in range(degree + 1) for j in range(degree + 1 - i))


@lru_cache
def coefficients(degree: int) -> Float[Tensor, "monomial term"]:
    """The solid harmonics of a degree as combinations of its monomials; their gradients have rms 1 at the unit sphere."""
    waves = [_solid(degree, m, is_sine) for m in range(degree + 1) for is_sine in (False, True)]
    columns = [
        [wave.get(e, 0.0) / _gradient_rms(wave, degree) for e in monomials(degree)] for wave in waves if wave
    ]
    return torch.tensor(columns, dtype=torch.float64).T


def _mixed(amplitude: Float[Tensor, "*batch term"], degree: int) -> Float[Tensor, "*batch monomial 3"]:
    """Coefficients of the field's components in the monomials of the degree below."""
    return torch.einsum("...t,tmi->...mi", amplitude, _gradient_table(degree).to(amplitude))


@lru_cache
def _gradient_table(degree: int) -> Float[Tensor, "term monomial 3"]:
    """Coefficients of each term's components in the monomials of the degree below."""
    row = {e: i for i, e in enumerate(monomials(degree - 1))}
    table = torch.zeros(2 * degree + 1, len(row), 3, dtype=torch.float64)
    for e, by_term in zip(monomials(degree), coefficients(degree), strict=True):
        for axis in range(3):
            if e[axis]:
                table[:, row[_lowered(e, axis)], axis] += e[axis] * by_term
    return table


def _raised(points: Tensor, powers: Tensor, degree: int) -> Tensor:
    """Monomials of a degree from those of the degree below."""
    below, axes = _raising(degree)
    return powers.index_select(-1, below.to(points.device)) * points.index_select(-1, axes.to(points.device))


@lru_cache
def _raising(degree: int) -> tuple[Int[Tensor, " monomial"], Int[Tensor, " monomial"]]:
    """Factors of each monomial of a degree: its row among those of the degree below, and the axis that multiplies it."""
    row = {e: i for i, e in enumerate(monomials(degree - 1))}
    axes = [next(axis for axis in range(3) if e[axis]) for e in monomials(degree)]
    below = [row[_lowered(e, axis)] for e, axis in zip(monomials(degree), axes, strict=True)]
    return torch.tensor(below), torch.tensor(axes)


def _lowered(e: Exponents, axis: int) -> Exponents:
    i, j, k = (power - (n == axis) for n, power in enumerate(e))
    return i, j, k


def _solid(degree: int, m: int, is_sine: bool) -> Polynomial:
    """Real or imaginary part of (x + i y)^m times its polynomial in z and r^2; empty for the sine of m = 0.

    References: NIST Digital Library of Mathematical Functions, section 14.7, for Rodrigues' formula behind the sum over k.
    """
    wave: Polynomial = {
        (m - n, n, 0): math.comb(m, n) * (-1.0) ** (n // 2) for n in range(m + 1) if n % 2 == is_sine
    }
    total: Polynomial = {}
    r2: Polynomial = {(2, 0, 0): 1.0, (0, 2, 0): 1.0, (0, 0, 2): 1.0}
    for k in range((degree - m) // 2 + 1):
        left = degree - 2 * k
        factor = (-1.0) ** k * math.comb(degree, k) * math.comb(degree + left, degree) * math.perm(left, m)
        part: Polynomial = _product(wave, {(0, 0, left - m): factor})
        for _ in range(k):
            part = _product(part, r2)
        for e, value in part.items():
            total[e] = total.get(e, 0.0) + value
    return total


def _product(first: Polynomial, second: Polynomial) -> Polynomial:
    result: Polynomial = {}
    for (a, b, c), value in first.items():
        for (d, e, f), other in second.items():
            power = (a + d, b + e, c + f)
            result[power] = result.get(power, 0.0) + value * other
    return result


def _gradient_rms(harmonic: Polynomial, degree: int) -> float:
    """Rms of the gradient at the unit sphere: l (2 l + 1) times the mean square of the harmonic, by Green's identity."""
    square = _product(harmonic, harmonic)
    mean = sum(value * _sphere_mean(e) for e, value in square.items())
    return math.sqrt(degree * (2 * degree + 1) * mean)


def _sphere_mean(e: Exponents) -> float:
    """Mean of a monomial over the unit sphere."""
    if any(power % 2 for power in e):
        return 0.0
    odd = [math.prod(range(1, power, 2)) for power in e]
    return math.prod(odd) / math.prod(range(1, sum(e) + 2, 2))
