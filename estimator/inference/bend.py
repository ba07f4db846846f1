"""A map that straightens a bent posterior: each whitened coordinate less a quadratic function of those before it.

Volumes stay as they are (the Jacobian is triangular with ones on its diagonal), so that densities carry over unchanged, and the inverse is
as simple: coordinate after coordinate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve

LARGEST_CURVATURE = 0.2  # prior standard deviation of a coefficient, in whitened units


@dataclass(frozen=True)
class Bend:
    """Quadratic functions of the coordinates before each one.

    Attributes:
        curvature: Coefficient of the product of coordinates j and k in coordinate i, shape (i, j, k); zero unless k <= j < i.
        slope: Coefficient of coordinate j in coordinate i, shape (i, j); zero unless j < i.
        offset: Constant of coordinate i, shape (i,).
    """

    curvature: np.ndarray
    slope: np.ndarray
    offset: np.ndarray

    @classmethod
    def none(cls, n: int) -> Bend:
        """The map that changes nothing."""
        return cls(np.zeros((n, n, n)), np.zeros((n, n)), np.zeros(n))

    @classmethod
    def fitted(cls, white: np.ndarray, weight: np.ndarray) -> Bend:
        """Weighted least squares, with a normal prior on the coefficients.

        Args:
            white: Points, shape (point, n).
            weight: Their weights, which add up to 1; they count as 1 / sum of squares points.
        Examples:
            >>> points = np.random.RandomState(0).standard_normal((4000, 2))
            >>> points[:, 1] += 3.0 * points[:, 0] ** 2
            >>> bend = Bend.fitted(points, np.full(4000, 1 / 4000))
            >>> round(bend.curvature[1, 0, 0], 1)
            np.float64(3.0)
        """
        n = white.shape[1]
        bend = cls.none(n)
        first, second = np.tril_indices(n)
        products = white[:, first] * white[:, second]
        # In the order of their latest coordinate, so that those before coordinate i are a leading part, with a leading part of the factor.
        order = np.argsort(np.concatenate(([-1], np.arange(n), first)), kind="stable")
        columns = np.concatenate((np.ones((len(white), 1)), white, products), axis=1)[:, order]
        penalty = np.repeat((1e-6, LARGEST_CURVATURE**-2), (n + 1, len(first)))[order]
        weighted = weight[:, None] * columns / (weight**2).sum()
        factor = np.linalg.cholesky(weighted.T @ columns + np.diag(penalty))
        projected = weighted.T @ white
        for i in range(n):
            n_columns = 1 + i + i * (i + 1) // 2
            leading = (factor[:n_columns, :n_columns], True)
            solution = np.zeros(len(order))
            solution[order[:n_columns]] = cho_solve(leading, projected[:n_columns, i])
            bend.offset[i], bend.slope[i] = solution[0], solution[1 : n + 1]
            bend.curvature[i, first, second] = solution[n + 1 :]
        return bend

    def straightened(self, white: np.ndarray) -> np.ndarray:
        """Coordinates less what the bend adds, shape (point, n)."""
        with np.errstate(over="ignore", invalid="ignore"):
            return np.asarray(white - self._added(white))

    def bent(self, straight: np.ndarray) -> np.ndarray:
        """Inverse of `straightened`.

        Examples:
            >>> bend = Bend(np.array([[[0.0, 0], [0, 0]], [[0.5, 0], [0, 0]]]), np.zeros((2, 2)), np.zeros(2))
            >>> bend.bent(np.array([[2.0, 1.0]]))
            array([[2., 3.]])
        """
        white = straight.copy()
        with np.errstate(over="ignore", invalid="ignore"):  # squares of squares, in the far tails
            for i in range(straight.shape[1]):
                white[:, i] += self._added_to(i, white)
        return white

    def _added(self, white: np.ndarray) -> np.ndarray:
        return np.stack([self._added_to(i, white) for i in range(white.shape[1])], axis=1)

    def _added_to(self, i: int, white: np.ndarray) -> np.ndarray:
        before = white[:, :i]
        quadratic = ((before @ self.curvature[i, :i, :i]) * before).sum(1)
        return np.asarray(quadratic + before @ self.slope[i, :i] + self.offset[i])
