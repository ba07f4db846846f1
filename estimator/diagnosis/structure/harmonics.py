"""Gradients of harmonic polynomials as flexible curves: their amplitudes have equal widths in the coefficients of the monomials."""

from __future__ import annotations

from functools import lru_cache

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.field.harmonics import coefficients, gradients


def harmonic_gradients(points: Float[Tensor, "point 3"], degree: int) -> Float[Tensor, "point term 3"]:
    """Gradients of the 2 l + 1 independent harmonic polynomials of one degree; free of divergence and curl.

    Args:
        points: Coordinates, best of order 1.
        degree: l >= 1; 1 gives the three uniform fields.
    Examples:
        >>> harmonic_gradients(torch.zeros(1, 3, dtype=torch.float64), 1).shape
        torch.Size([1, 3, 3])
    """
    fields: Tensor = torch.einsum(
        "pti,tu->pui", gradients(points, degree), _orthonormalised(degree).to(points.device)
    )
    return fields


@lru_cache
def _orthonormalised(degree: int) -> Float[Tensor, "term term"]:
    """Combinations of the solid harmonics that are orthonormal in their coefficients."""
    mixing: Tensor = torch.linalg.inv(torch.linalg.qr(coefficients(degree)).R)
    return mixing
