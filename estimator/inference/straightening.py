"""A bend fitted to log densities: after it the posterior is as normal as a triangular quadratic map can make it.

Where weighted draws lie tells of a law with the noise of counting. Their log densities have no noise, so a thousand of them give a few
hundred coefficients of a map. The map turns whitened coordinates into straight ones: each is scaled, less a quadratic function of those
before it. Its coefficients are those with which a normal law of straight coordinates comes nearest to the posterior's log densities.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_array

from estimator.inference.bend import LARGEST_CURVATURE, Bend

ITERATIONS, HALVINGS, LEAST_GAIN = 10, 4, 0.02
LEAST_NOISE = 1e-3  # variance of log densities that no map of this kind explains
FARTHEST = 100.0  # whitened units: what a bend threw farther has squares beyond the range of numbers, and tells nothing of the middle
MOST_PRODUCTS = 20  # coordinates up to which products of different ones are fitted; above it squares


@dataclass(frozen=True)
class Straightening:
    """A map to straight coordinates, in which the law is a standard normal one.

    Attributes:
        bend: Quadratic functions that are subtracted.
        spread: Standard deviation of each straightened coordinate, shape (n,).
        coefficients: What both were made of.
    """

    bend: Bend
    spread: np.ndarray
    coefficients: np.ndarray

    @classmethod
    def fitted(
        cls,
        white: np.ndarray,
        log_density: np.ndarray,
        weight: np.ndarray,
        row: np.ndarray,
        begin: Straightening | None = None,
    ) -> Straightening:
        """Weighted least squares of log densities by Gauss-Newton steps, with a normal prior on the coefficients.

        Args:
            white: Points, shape (point, n).
            log_density: Of the posterior at them; each tuple of counts has a constant of its own.
            weight: How much each counts; they add up to 1.
            row: Tuple of counts of each point.
            begin: Map to begin from; by default the identity.
        Examples:
            >>> points = np.random.RandomState(0).standard_normal((400, 2))
            >>> straight = np.stack((points[:, 0], points[:, 1] - 0.5 * points[:, 0] ** 2), axis=1)
            >>> log_density = -0.5 * (straight**2).sum(1)
            >>> found = Straightening.fitted(points, log_density, np.full(400, 1 / 400), np.zeros(400, dtype=int))
            >>> round(found.bend.curvature[1, 0, 0], 2)
            np.float64(0.5)
        """
        n = white.shape[1]
        begin = cls(Bend.none(n), np.ones(n), np.zeros(n_coefficients(n))) if begin is None else begin
        is_near = (np.abs(white) < FARTHEST).all(1) & (weight > 0.0)
        if not is_near.any():
            return begin
        weight = weight[is_near] / weight[is_near].sum()
        problem = _Problem(white[is_near], log_density[is_near], weight, row[is_near])
        coefficients = begin.coefficients
        residual = problem.residual(coefficients)
        for _ in range(ITERATIONS):
            variance = float(weight @ residual**2)
            step = problem.step(coefficients, residual, max(variance, LEAST_NOISE))
            for halving in range(HALVINGS):
                there = coefficients + 0.5**halving * step
                residual_there = problem.residual(there)
                variance_there = float(weight @ residual_there**2)
                if variance_there < variance:
                    break
            else:
                break
            coefficients, residual = there, residual_there
            if variance_there > (1.0 - LEAST_GAIN) * variance:
                break
        return problem.straightening(coefficients)


def n_coefficients(n: int) -> int:
    """Number of coefficients of a map of n coordinates."""
    return int(_sizes(n).sum())


def _sizes(n: int) -> np.ndarray:
    """Coefficients of each coordinate: log scale, offset, slopes, products."""
    return np.array([2 + i + len(_pairs(n, i)[0]) for i in range(n)])


def _pairs(n: int, i: int) -> tuple[np.ndarray, np.ndarray]:
    """The products in coordinate i of n: of all that come before it, or of each with itself."""
    return np.tril_indices(i) if n <= MOST_PRODUCTS else (np.arange(i), np.arange(i))


class _Problem:
    """Residuals of log densities, and their derivatives by the coefficients."""

    def __init__(
        self, white: np.ndarray, log_density: np.ndarray, weight: np.ndarray, row: np.ndarray
    ) -> None:
        self.white, self.log_density, self.weight = white, log_density, weight
        self.n = white.shape[1]
        _, self.group = np.unique(row, return_inverse=True)
        share = weight / np.bincount(self.group, weight)[self.group]
        self.mean_of_group = csr_array((share, (self.group, np.arange(len(white)))))
        sizes = _sizes(self.n)
        self.ends = np.cumsum(sizes)
        is_product = np.concatenate([np.arange(size) >= 2 + i for i, size in enumerate(sizes)])
        self.penalty = np.where(is_product, LARGEST_CURVATURE**-2, 1.0)

    def residual(self, coefficients: np.ndarray) -> np.ndarray:
        """Log densities less those of the normal law, less the mean of each tuple."""
        total = self.log_density.copy()
        with np.errstate(over="ignore", invalid="ignore"):
            for i in range(self.n):
                straight, _ = self._straight(i, coefficients)
                total += 0.5 * straight**2 - coefficients[self._begin(i)]
        return self._centred(total[:, None])[:, 0]

    def step(self, coefficients: np.ndarray, residual: np.ndarray, noise: float) -> np.ndarray:
        """Gauss-Newton step of the coefficients.

        Args:
            noise: Variance of the residuals that no coefficients explain.
        """
        columns = []
        for i in range(self.n):
            straight, features = self._straight(i, coefficients)
            scaled = np.exp(coefficients[self._begin(i)]) * self.white[:, i]
            columns += [(1.0 - straight * scaled)[:, None], straight[:, None] * features]
        jacobian = self._centred(np.concatenate(columns, axis=1))
        n_effective = 1.0 / float((self.weight**2).sum())
        root = np.sqrt((n_effective / noise) * self.weight)
        weighted = root[:, None] * jacobian
        information = weighted.T @ weighted  # of one array, which NumPy computes by half
        information.flat[:: len(self.penalty) + 1] += self.penalty
        slope = weighted.T @ (root * residual) - self.penalty * coefficients
        return np.asarray(cho_solve(cho_factor(information), slope))

    def straightening(self, coefficients: np.ndarray) -> Straightening:
        """The map that coefficients stand for; its scales become spreads of what is not scaled."""
        bend = Bend.none(self.n)
        spread = np.empty(self.n)
        for i in range(self.n):
            mine = coefficients[self._begin(i) : self.ends[i]]
            spread[i] = np.exp(-mine[0])
            unscaled = spread[i] * mine[1:]
            bend.offset[i], bend.slope[i, :i] = unscaled[0], unscaled[1 : 1 + i]
            first, second = _pairs(self.n, i)
            bend.curvature[i, first, second] = unscaled[1 + i :]
        return Straightening(bend, spread, coefficients)

    def _begin(self, i: int) -> int:
        return int(self.ends[i - 1]) if i else 0

    def _straight(self, i: int, coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Straight coordinate i, and what its offset, slopes and products multiply."""
        before = self.white[:, :i]
        first, second = _pairs(self.n, i)
        features = np.concatenate(
            (np.ones((len(before), 1)), before, before[:, first] * before[:, second]), axis=1
        )
        mine = coefficients[self._begin(i) : self.ends[i]]
        return np.exp(mine[0]) * self.white[:, i] - features @ mine[1:], features

    def _centred(self, columns: np.ndarray) -> np.ndarray:
        """Columns less the weighted mean of each tuple."""
        mean = self.mean_of_group @ columns
        return np.asarray(columns - mean[self.group])
