"""A bend fitted to log densities: after it the posterior is as normal as a triangular quadratic map can make it.

The positions of weighted draws carry counting noise. Their log densities have none, so a thousand of them determine a few hundred
coefficients of a map. The map turns whitened coordinates into straight ones: each is scaled, less a quadratic function of those before it.
Its coefficients are those with which a normal distribution of straight coordinates comes nearest to the posterior's log densities.
Thirty coordinates have thousands of terms. Only those that the log densities show clearly are fitted, as where a sensor's zero depends on
a field times an angle: the others would fit noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_array

from estimator.inference.bend import LARGEST_CURVATURE, Bend

ITERATIONS, HALVINGS, LEAST_GAIN = 10, 4, 0.02
LEAST_NOISE = 1e-3  # variance of log densities that no map of this kind explains
FARTHEST = 100.0  # whitened units: squares of points that a bend threw farther out overflow, and say nothing of the middle
# Terms of more coordinates: as many are added at once, this often, for so many effective points each, where they are so clear.
ADDED, TIMES, POINTS_PER_TERM, CLEAR_SD = 100, 3, 4.0, 2.0


class Terms(NamedTuple):
    """Terms of quadratic functions: products of two entries of the vector (1, coordinates), in the order of `coordinate`.

    Attributes:
        coordinate: The one that a term is subtracted from.
        first, second: Numbers of the entries; 0 is the constant, and no other is larger than `coordinate`.
    """

    coordinate: np.ndarray
    first: np.ndarray
    second: np.ndarray

    @classmethod
    def all(cls, n: int) -> Terms:
        """Offset, slopes and products of each of n coordinates."""
        pairs = [np.tril_indices(i + 1) for i in range(n)]
        coordinate = np.repeat(np.arange(n), [len(first) for first, _ in pairs])
        return cls(coordinate, *(np.concatenate(each) for each in zip(*pairs, strict=True)))

    @classmethod
    def offsets(cls, n: int) -> Terms:
        """An offset of each of n coordinates alone."""
        none = np.zeros(n, dtype=int)
        return cls(np.arange(n), none, none)

    def of(self, i: int) -> slice:
        """Numbers of the terms of one coordinate."""
        begin, end = np.searchsorted(self.coordinate, (i, i + 1))
        return slice(int(begin), int(end))


@dataclass(frozen=True)
class Straightening:
    """A map to straight coordinates, in which the posterior is a standard normal distribution.

    Attributes:
        bend: Quadratic functions that are subtracted.
        spread: Standard deviation of each straightened coordinate, shape (n,).
        terms: Of these functions.
        coefficients: What both were made of: log scales, then those of the terms.
    """

    bend: Bend
    spread: np.ndarray
    terms: Terms
    coefficients: np.ndarray

    @classmethod
    def none(cls, n: int) -> Straightening:
        """The identity."""
        terms = Terms.offsets(n)
        return cls(Bend.none(n), np.ones(n), terms, np.zeros(n + len(terms.coordinate)))

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
        begin = cls.none(white.shape[1]) if begin is None else begin
        is_near = (np.abs(white) < FARTHEST).all(1) & (weight > 0.0)
        if not is_near.any():
            return begin
        weight = weight[is_near] / weight[is_near].sum()
        problem = _Problem(white[is_near], log_density[is_near], weight, row[is_near], begin.terms)
        coefficients = problem.descended(begin.coefficients)
        for _ in range(TIMES):
            problem, coefficients = problem.with_more(coefficients)
            coefficients = problem.descended(coefficients)
        return problem.straightening(coefficients)


def most_coefficients(n: int) -> int:
    """Number of coefficients of a map of n coordinates with all terms."""
    return n + len(Terms.all(n).coordinate)


class _Problem:
    """Residuals of log densities, and their derivatives by the coefficients."""

    def __init__(
        self, white: np.ndarray, log_density: np.ndarray, weight: np.ndarray, row: np.ndarray, terms: Terms
    ) -> None:
        self.white, self.log_density, self.weight, self.row, self.terms = (
            white,
            log_density,
            weight,
            row,
            terms,
        )
        self.n = white.shape[1]
        self.entries = np.concatenate((np.ones((len(white), 1)), white), axis=1)
        _, self.group = np.unique(row, return_inverse=True)
        share = weight / np.bincount(self.group, weight)[self.group]
        self.mean_of_group = csr_array((share, (self.group, np.arange(len(white)))))
        self.n_effective = 1.0 / float((weight**2).sum())
        self.penalty = np.where(terms.second > 0, LARGEST_CURVATURE**-2, 1.0)
        self.penalty = np.concatenate((np.ones(self.n), self.penalty))

    def descended(self, coefficients: np.ndarray) -> np.ndarray:
        """Coefficients after Gauss-Newton steps from some others."""
        residual = self.residual(coefficients)
        for _ in range(ITERATIONS):
            variance = float(self.weight @ residual**2)
            step = self.step(coefficients, residual, max(variance, LEAST_NOISE))
            for halving in range(HALVINGS):
                there = coefficients + 0.5**halving * step
                residual_there = self.residual(there)
                variance_there = float(self.weight @ residual_there**2)
                if variance_there < variance:
                    break
            else:
                break
            coefficients, residual = there, residual_there
            if variance_there > (1.0 - LEAST_GAIN) * variance:
                break
        return coefficients

    def residual(self, coefficients: np.ndarray) -> np.ndarray:
        """Log densities less those of the normal distribution, less the mean of each tuple."""
        with np.errstate(over="ignore", invalid="ignore"):
            total = self.log_density + 0.5 * (self.straight(coefficients) ** 2).sum(1)
        return self._centred(total[:, None])[:, 0]

    def straight(self, coefficients: np.ndarray) -> np.ndarray:
        """Straight coordinates of the points."""
        subtracted = [
            self._features(of) @ coefficients[self.n :][of] for of in map(self.terms.of, range(self.n))
        ]
        return np.asarray(np.exp(coefficients[: self.n]) * self.white - np.stack(subtracted, axis=1))

    def step(self, coefficients: np.ndarray, residual: np.ndarray, noise: float) -> np.ndarray:
        """Gauss-Newton step of the coefficients.

        Args:
            noise: Variance of the residuals that no coefficients explain.
        """
        straight = self.straight(coefficients)
        scaled = np.exp(coefficients[: self.n]) * self.white
        of_terms = straight[:, self.terms.coordinate] * self._features(slice(None))
        jacobian = self._centred(np.concatenate((1.0 - straight * scaled, of_terms), axis=1))
        root = np.sqrt((self.n_effective / noise) * self.weight)
        weighted = root[:, None] * jacobian
        information = weighted.T @ weighted  # of one array, which NumPy computes by half
        information.flat[:: len(self.penalty) + 1] += self.penalty
        slope = weighted.T @ (root * residual) - self.penalty * coefficients
        return np.asarray(cho_solve(cho_factor(information), slope))

    def with_more(self, coefficients: np.ndarray) -> tuple[_Problem, np.ndarray]:
        """The problem with the terms too that the residuals show most clearly, and coefficients of which these are zero."""
        every = Terms.all(self.n)
        first, second = np.tril_indices(self.n + 1)
        products = self.entries[:, first] * self.entries[:, second]
        residual, straight = self.residual(coefficients), self.straight(coefficients)
        score = (self.weight[:, None] * residual[:, None] * straight).T @ products
        square = (self.weight[:, None] * straight**2).T @ products**2
        noise = max(float(self.weight @ residual**2), LEAST_NOISE)
        is_before = first <= np.arange(self.n)[:, None]  # in the order of `every`
        clear = self.n_effective / noise * (score**2 / square)[is_before]
        known = set(zip(*self.terms, strict=True))
        clear[[term in known for term in zip(*every, strict=True)]] = 0.0
        most = min(ADDED, max(int(self.n_effective / POINTS_PER_TERM) - len(known), 0))
        best = np.argsort(-clear)[:most]
        best = best[clear[best] > CLEAR_SD**2]
        terms = [np.concatenate((mine, more[best])) for mine, more in zip(self.terms, every, strict=True)]
        order = np.argsort(terms[0], kind="stable")
        of_terms = np.concatenate((coefficients[self.n :], np.zeros(len(best))))[order]
        problem = _Problem(
            self.white, self.log_density, self.weight, self.row, Terms(*(each[order] for each in terms))
        )
        return problem, np.concatenate((coefficients[: self.n], of_terms))

    def straightening(self, coefficients: np.ndarray) -> Straightening:
        """The map that coefficients stand for; its scales become spreads of what is not scaled."""
        spread = np.exp(-coefficients[: self.n])
        whole = np.zeros((self.n, self.n + 1, self.n + 1))
        coordinate, first, second = self.terms
        whole[coordinate, first, second] = spread[coordinate] * coefficients[self.n :]
        bend = Bend(whole[:, 1:, 1:], whole[:, 1:, 0], whole[:, 0, 0])
        return Straightening(bend, spread, self.terms, coefficients)

    def _features(self, terms: slice) -> np.ndarray:
        """Factors of the coefficients of some terms."""
        return np.asarray(
            self.entries[:, self.terms.first[terms]] * self.entries[:, self.terms.second[terms]]
        )

    def _centred(self, columns: np.ndarray) -> np.ndarray:
        """Columns less the weighted mean of each tuple."""
        mean = self.mean_of_group @ columns
        return np.asarray(columns - mean[self.group])
