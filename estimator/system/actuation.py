"""Currents for a wanted field or force, from what each coil does per ampere: linear algebra over any batch of points.

An actuation matrix has a column per coil. Its first three rows are the field per ampere; the five that may follow are the independent
entries of the gradient, which is symmetric and traceless where there is no current (Petruska and Nelson, IEEE Trans. Robot. 31, 714
(2015), section II).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.optimize import lsq_linear

from estimator.errors import InvalidInput
from estimator.tensors import Tensor, torch

INDEPENDENT = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2))  # (i, j) of the dB_i / dx_j that determine all nine
RIDGE = 1e-7  # in largest singular values: picks the smallest among bounded currents that do equally well


def independent_entries(gradient: Float[Tensor, "*batch 3 3"]) -> Float[Tensor, "*batch 5"]:
    """dBx/dx, dBx/dy, dBx/dz, dBy/dy, dBy/dz.

    Examples:
        >>> independent_entries(torch.tensor([[1.0, 2.0, 3.0], [2.0, 4.0, 5.0], [3.0, 5.0, -5.0]])).tolist()
        [1.0, 2.0, 3.0, 4.0, 5.0]
    """
    return torch.stack([gradient[..., i, j] for i, j in INDEPENDENT], dim=-1)


def force_matrix(
    actuation: Float[Tensor, "*#batch 8 coil"], moment_A_m2: Float[Tensor, "*#batch 3"]
) -> Float[Tensor, "*batch 3 coil"]:
    """Force on a dipole per ampere, in N/A: F_j = sum over i of m_i dB_i/dx_j, the gradient of m.B at constant moment.

    Args:
        actuation: Field and gradient per ampere.
        moment_A_m2: Moment of the dipole in the world frame.
    References: Jackson, Classical Electrodynamics, 3rd ed., eq 5.69.
    Examples:
        >>> rows = torch.zeros(8, 1, dtype=torch.float64)
        >>> rows[3:, 0] = torch.tensor([1.0, 2.0, 3.0, 4.0, 5.0])
        >>> force_matrix(rows, torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64))[:, 0].tolist()
        [3.0, 5.0, -5.0]
    """
    xx, xy, xz, yy, yz = actuation[..., 3:, :].unbind(-2)
    x, y, z = (moment_A_m2[..., i, None] for i in range(3))
    return torch.stack(
        (x * xx + y * xy + z * xz, x * xy + y * yy + z * yz, x * xz + y * yz - z * (xx + yy)), -2
    )


def minimum_norm_currents(
    matrix: Float[Tensor, "*#batch row coil"], target: Float[Tensor, "*#batch row"]
) -> Float[Tensor, "*batch coil"]:
    """The smallest currents among those that come closest to a target; differentiable where the matrix has full rank.

    Args:
        matrix: What each coil does per ampere; rows of different units must be weighted first.
        target: Field or force that is wanted.
    Returns: Currents in ampere; NaN where the matrix is NaN, inside a winding.
    Examples:
        >>> two_alike = torch.tensor([[1e-3, 1e-3]], dtype=torch.float64)
        >>> [round(i, 9) for i in minimum_norm_currents(two_alike, torch.tensor([4e-3], dtype=torch.float64)).tolist()]
        [2.0, 2.0]
    """
    is_finite = torch.isfinite(matrix).all(-1).all(-1)
    inverse = torch.linalg.pinv(torch.where(is_finite[..., None, None], matrix, 0.0))
    currents_A = (inverse @ target[..., None])[..., 0]
    return torch.where(is_finite[..., None], currents_A, torch.nan)


def bounded_currents(
    matrix: Float[Tensor, "*#batch row coil"],
    target: Float[Tensor, "*#batch row"],
    most_A: Float[Tensor, " coil"],
) -> Float[Tensor, "*batch coil"]:
    """The currents within bounds that come closest to a target, solved point by point, without derivatives.

    Minimum-norm currents within the bounds are the answer.

    Args:
        matrix, target: As in `minimum_norm_currents`.
        most_A: Largest magnitude of each current.
    Returns: Currents in ampere; NaN where the matrix is NaN.
    Raises:
        InvalidInput: A bound that is not positive.
    References: Stark and Parker, Comput. Stat. 10, 129 (1995), as in scipy.optimize.lsq_linear.
    Examples:
        >>> two_alike = torch.tensor([[1e-3, 1e-3]], dtype=torch.float64)
        >>> wanted = torch.tensor([4e-3], dtype=torch.float64)
        >>> [round(i, 6) for i in bounded_currents(two_alike, wanted, torch.tensor([1.0, 5.0]).double()).tolist()]
        [1.0, 3.0]
    """
    if not bool((most_A > 0.0).all()):
        raise InvalidInput(f"largest currents must be > 0; received {most_A.tolist()}")
    currents_A = minimum_norm_currents(matrix.detach(), target.detach())
    exceeds = (currents_A.abs() > most_A).any(-1)
    n_rows, n_coils = matrix.shape[-2:]
    matrices = matrix.detach().expand(*currents_A.shape[:-1], n_rows, n_coils)[exceeds].numpy()
    targets = target.detach().expand(*currents_A.shape[:-1], n_rows)[exceeds].numpy()
    bounded_A = [_bounded_at_point(*point, most_A.numpy()) for point in zip(matrices, targets, strict=True)]
    if bounded_A:
        currents_A[exceeds] = torch.from_numpy(np.stack(bounded_A)).to(currents_A.dtype)
    return currents_A


def _bounded_at_point(matrix: np.ndarray, target: np.ndarray, most_A: np.ndarray) -> np.ndarray:
    """Bounded currents at one point; the ridge makes them unique where there are more coils than rows."""
    norm = np.linalg.norm(matrix, 2)
    matrix_and_ridge = np.vstack((matrix / norm, RIDGE * np.eye(len(most_A))))
    target_and_zeros = np.concatenate((target / norm, np.zeros(len(most_A))))
    return np.asarray(lsq_linear(matrix_and_ridge, target_and_zeros, (-most_A, most_A), method="bvls").x)
