"""Systems, inverses and determinants of positive definite matrices, each scaled to a unit diagonal first.

Coordinates differ by many powers of ten; without the scaling their units would cost digits. Cholesky's factors take half the time of LU's.
Besides, the LU of a batch of more than some 150 rows fails or never ends where torch has several threads
(https://github.com/pytorch/pytorch/issues/141358).
"""

from __future__ import annotations

from collections.abc import Callable

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
    if failed.any():
        return scale[..., None] * _one_by_one(torch.linalg.solve, scaled, right)
    return scale[..., None] * torch.cholesky_solve(right, factor)


def inverse(matrix: Float[Tensor, "*batch row row"]) -> Float[Tensor, "*batch row row"]:
    """Inverse, symmetric to the last digit.

    Examples:
        >>> inverse(torch.diag(torch.tensor([4.0, 1e12], dtype=torch.float64))).diagonal().tolist()
        [0.25, 1e-12]
    """
    scaled, scale = _scaled(matrix)
    factor, failed = torch.linalg.cholesky_ex(scaled)
    unscaled = _one_by_one(torch.linalg.inv, scaled) if failed.any() else torch.cholesky_inverse(factor)
    result = unscaled * scale[..., :, None] * scale[..., None, :]
    return 0.5 * (result + result.mT)


def log_determinant(matrix: Float[Tensor, "*batch row row"]) -> Float[Tensor, "*batch"]:
    """Logarithm of the determinant; of its amount where rounding has made a matrix indefinite.

    Examples:
        >>> round(log_determinant(torch.diag(torch.tensor([1.0, 100.0], dtype=torch.float64))).item(), 5)
        4.60517
    """
    scaled, scale = _scaled(matrix)
    factor, failed = torch.linalg.cholesky_ex(scaled)
    if failed.any():
        of_scaled = _one_by_one(lambda each: torch.linalg.slogdet(each).logabsdet, scaled)
    else:
        of_scaled = 2.0 * diagonal_of(factor).log().sum(-1)
    return of_scaled - 2.0 * scale.log().sum(-1)


def lower_factor(matrix: Float[Tensor, "*batch row row"]) -> Float[Tensor, "*batch row row"]:
    """Lower triangular factor L of a covariance L L^T, with a positive diagonal.

    Directions that rounding has made negative, as in the inverse of a nearly singular precision, get the least variance that rounding
    leaves.

    Examples:
        >>> lower_factor(torch.diag(torch.tensor([4.0, 1e12], dtype=torch.float64))).diagonal().tolist()
        [2.0, 1000000.0]
    """
    scaled, scale = _scaled(matrix)
    factor, failed = torch.linalg.cholesky_ex(scaled)
    if failed.any():
        factor = torch.where(failed[..., None, None] != 0, _one_by_one(_nearest_factor, scaled), factor)
    return factor / scale[..., :, None]


def inner_products(columns: Float[Tensor, "*batch row column"]) -> Float[Tensor, "*batch column column"]:
    """Inner products of the columns of a matrix with each other. NumPy computes only half of so symmetric a product.

    Examples:
        >>> inner_products(torch.tensor([[1.0, 2.0], [0.0, 1.0]]))
        tensor([[1., 2.],
                [2., 5.]])
    """
    if columns.device.type != "cpu":
        return columns.mT @ columns
    array = columns.detach().numpy()
    return torch.from_numpy(array.swapaxes(-1, -2) @ array)


def diagonal_of(matrix: Float[Tensor, "*batch row row"]) -> Float[Tensor, "*batch row"]:
    """Diagonal of each matrix."""
    return torch.diagonal(matrix, dim1=-2, dim2=-1)


def _scaled(matrix: Tensor) -> tuple[Tensor, Tensor]:
    """The matrix with a unit diagonal, and what rows and columns were multiplied by."""
    scale = diagonal_of(matrix).clamp(min=1e-300).rsqrt()
    return matrix * scale[..., :, None] * scale[..., None, :], scale


def _nearest_factor(matrix: Float[Tensor, "row row"]) -> Float[Tensor, "row row"]:
    """Lower factor of the nearest covariance in which rounding has made no direction negative."""
    if not torch.isfinite(matrix).all():
        return torch.full_like(matrix, torch.nan)
    eigenvalues, vectors = torch.linalg.eigh(matrix)
    least = len(matrix) * torch.finfo(matrix.dtype).eps * eigenvalues[-1]
    upper = torch.linalg.qr((vectors * eigenvalues.clamp(min=least).sqrt()).mT).R
    return (upper * torch.sgn(upper.diagonal())[:, None]).mT


def _one_by_one(function: Callable[..., Tensor], *stacks: Float[Tensor, "*batch _ _"]) -> Tensor:
    """A function by LU of one matrix after another, where rounding has made some indefinite, or they have no value."""
    batch = stacks[0].shape[:-2]
    rows = zip(*(stack.reshape(-1, *stack.shape[-2:]) for stack in stacks), strict=True)
    results = torch.stack([function(*row) for row in rows])
    return results.reshape(*batch, *results.shape[1:])
