"""Smooth functions of covariates: Legendre polynomials in one axis and in three."""

from __future__ import annotations

from itertools import product

import torch
from jaxtyping import Float
from torch import Tensor


def unit_interval(values: Float[Tensor, "reading axis"]) -> Float[Tensor, "reading axis"]:
    """Values scaled linearly to -1 .. 1 along each axis."""
    low, high = values.min(0).values, values.max(0).values
    return (2.0 * values - low - high) / (high - low).clamp(min=1e-12)


def legendre(x: Float[Tensor, " reading"], degree: int) -> Float[Tensor, "reading order"]:
    """Legendre polynomials up to a degree; column n is divided by 1 + n / 2."""
    orders = [torch.ones_like(x), x]
    for n in range(1, degree):
        orders.append(((2 * n + 1) * x * orders[n] - n * orders[n - 1]) / (n + 1))
    return torch.stack([order / (1.0 + 0.5 * n) for n, order in enumerate(orders)], dim=1)


def polynomials(x: Float[Tensor, "reading axis"], degree: int) -> Float[Tensor, "reading order"]:
    """Products of Legendre polynomials in three axes up to a total degree."""
    along_x, along_y, along_z = (legendre(x[:, i], degree) for i in range(3))
    orders = [each for each in product(range(degree + 1), repeat=3) if sum(each) <= degree]
    return torch.stack([along_x[:, i] * along_y[:, j] * along_z[:, k] for i, j, k in orders], dim=1)
