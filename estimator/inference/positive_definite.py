"""Systems, inverses and determinants of positive definite matrices, each scaled to a unit diagonal first.

Coordinates differ by many powers of ten; without the scaling their units would cost digits. Cholesky's factors take half the time of LU's.
Besides, the LU of a batch of more than some 150 rows fails or never ends where torch has several threads
(https://github.com/pytorch/pytorch/issues/141358).
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

JITTER = 1e-14  # of a unit diagonal: what rounding may have taken from it


def solve(
    matrix: Float[Tensor, "*batch row row"], right: Float[Tensor, "*batch row"]
) -> Float[Tensor, "*batch row"]:
    """Solution of a system.

    Examples:
        >>> solve(torch.diag(torch.tensor([4.0, 1e12], dtype=torch.float64)), torch.ones(2, dtype=torch.float64)).tolist()
        [0.25, 1e-12]
    """
    return solve_each(matrix, right[..., None])[..., 0]


def solve_each(
    matrix: Float[Tensor, "*batch row row"], columns: Float[Tensor, "*batch row column"]
) -> Float[Tensor, "*batch row column"]:
    """Solutions of one system for several right sides."""
    scaled, scale = _scaled(matrix)
    scaled = scaled + JITTER * torch.eye(matrix.shape[-1], dtype=matrix.dtype, device=matrix.device)
    right = scale[..., None] * columns
    factor, failed = torch.linalg.cholesky_ex(scaled)
    solution = _by_lu(scaled, right) if failed.any() else torch.cholesky_solve(right, factor)
    return scale[..., None] * solution


def inverse(matrix: Float[Tensor, "*batch row row"]) -> Float[Tensor, "*batch row row"]:
    """Inverse, symmetric to the last digit.

    Examples:
        >>> inverse(torch.diag(torch.tensor([4.0, 1e12], dtype=torch.float64))).diagonal().tolist()
        [0.25, 1e-12]
    """
    scaled, scale = _scaled(matrix)
    factor, failed = torch.linalg.cholesky_ex(scaled)
    if failed.any():
        unit = torch.eye(matrix.shape[-1], dtype=matrix.dtype, device=matrix.device)
        unscaled = _by_lu(scaled, unit.expand_as(scaled))
    else:
        unscaled = torch.cholesky_inverse(factor)
    result = unscaled * scale[..., :, None] * scale[..., None, :]
    symmetric: Tensor = 0.5 * (result + result.mT)
    return symmetric


def log_determinant(matrix: Float[Tensor, "*batch row row"]) -> Float[Tensor, "*batch"]:
    """Logarithm of the determinant; of its amount where rounding has made a matrix indefinite.

    Examples:
        >>> round(log_determinant(torch.diag(torch.tensor([1.0, 100.0], dtype=torch.float64))).item(), 5)
        4.60517
    """
    scaled, scale = _scaled(matrix)
    factor, failed = torch.linalg.cholesky_ex(scaled)
    of_scaled = (
        torch.linalg.eigvalsh(scaled).abs().log().sum(-1)
        if failed.any()
        else 2.0 * diagonal_of(factor).log().sum(-1)
    )
    log_det: Tensor = of_scaled - 2.0 * scale.log().sum(-1)
    return log_det


def diagonal_of(matrix: Float[Tensor, "*batch row row"]) -> Float[Tensor, "*batch row"]:
    """Diagonal of each matrix."""
    return torch.diagonal(matrix, dim1=-2, dim2=-1)


def _scaled(matrix: Tensor) -> tuple[Tensor, Tensor]:
    """The matrix with a unit diagonal, and what rows and columns were multiplied by."""
    scale = diagonal_of(matrix).clamp(min=1e-300).rsqrt()
    return matrix * scale[..., :, None] * scale[..., None, :], scale


def _by_lu(matrix: Tensor, columns: Tensor) -> Tensor:
    """Solutions where rounding has made a matrix indefinite, one matrix after another."""
    batch = matrix.shape[:-2]
    pairs = zip(
        matrix.reshape(-1, *matrix.shape[-2:]),
        columns.expand(*batch, *columns.shape[-2:]).reshape(-1, *columns.shape[-2:]),
        strict=True,
    )
    return torch.stack([torch.linalg.solve(one, right) for one, right in pairs]).reshape(
        *batch, *columns.shape[-2:]
    )
