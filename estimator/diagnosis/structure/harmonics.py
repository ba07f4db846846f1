"""Gradients of harmonic polynomials: the static fields of sources outside the region where they are used."""

from __future__ import annotations

from functools import lru_cache
from itertools import product

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

Exponents = tuple[int, int, int]


def harmonic_gradients(points: Float[Tensor, "point 3"], degree: int) -> Float[Tensor, "point term 3"]:
    """Gradients of the 2 l + 1 independent harmonic polynomials of one degree; free of divergence and curl.

    Args:
        points: Coordinates, best of order 1.
        degree: l >= 1; 1 gives the three uniform fields.
    References: Jackson, Classical Electrodynamics, 3rd ed., section 3.3 (solid harmonics).
    Examples:
        >>> harmonic_gradients(torch.zeros(1, 3, dtype=torch.float64), 1).shape
        torch.Size([1, 3, 3])
    """
    exponents, coefficients = _harmonics(degree)
    powers = torch.stack([points**n for n in range(degree + 1)])  # power, point, axis
    columns = []
    for axis in range(3):
        terms = []
        for e in exponents:
            lowered = [e[i] - (i == axis) for i in range(3)]
            if lowered[axis] < 0:
                terms.append(torch.zeros_like(points[:, 0]))
            else:
                factors = [powers[n][:, i] for i, n in enumerate(lowered)]
                terms.append(e[axis] * factors[0] * factors[1] * factors[2])
        columns.append(torch.stack(terms, dim=-1) @ torch.from_numpy(coefficients))
    return torch.stack(columns, dim=-1)


@lru_cache
def _harmonics(degree: int) -> tuple[list[Exponents], np.ndarray]:
    """Monomials of a degree, and the combinations of them whose Laplacian is zero."""
    exponents = _monomials(degree)
    lower = _monomials(degree - 2) if degree >= 2 else []
    row = {e: i for i, e in enumerate(lower)}
    laplace = np.zeros((max(len(lower), 1), len(exponents)))
    for column, e in enumerate(exponents):
        for axis in range(3):
            if e[axis] >= 2:
                target = [*e]
                target[axis] -= 2
                laplace[row[target[0], target[1], target[2]], column] += e[axis] * (e[axis] - 1)
    _, size, right = np.linalg.svd(laplace)
    rank = int((size > 1e-10).sum())
    return exponents, np.ascontiguousarray(right[rank:].T)


def _monomials(degree: int) -> list[Exponents]:
    exponents = product(range(degree + 1), repeat=3)
    return [(i, j, k) for i, j, k in exponents if i + j + k == degree]
