"""The distribution over loop counts and continuous coordinates from which the moves of the sampler propose.

Each tuple of counts has its own maximum and Laplace covariance. They whiten the coordinates: in whitened coordinates the posterior of every
tuple is a standard normal, as far as the Laplace approximation holds. Deviations from that are the same for all tuples: a `Bend`, and in
the straightened coordinates a `WhiteShape`, a few Student-t distributions. At first there is no bend and a single distribution about the
origin; `estimator.inference.adaptation` fits both to the posterior.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln, logsumexp

from estimator.devices import numpy_of
from estimator.inference.bend import Bend
from estimator.inference.lattice import CountMixture
from estimator.inference.positive_definite import lower_factor

DEGREES_OF_FREEDOM = 12.0
FLOOR = 0.05  # share of proposals spread evenly over all tuples, so that each is proposed now and then


@dataclass(frozen=True)
class WhiteShape:
    """A mixture of Student-t distributions in whitened and straightened coordinates.

    Attributes:
        weight: Probability of each component, shape (component,); they add up to 1.
        mean: Mean of each component, shape (component, n).
        factor: Lower triangle of the Cholesky factor of each scale matrix, shape (component, n, n).
        freedom: Degrees of freedom of each component, shape (component,), or of all.
    """

    weight: np.ndarray
    mean: np.ndarray
    factor: np.ndarray
    freedom: np.ndarray | float = DEGREES_OF_FREEDOM

    @classmethod
    def standard(cls, n: int) -> WhiteShape:
        """One component about the origin with unit scale."""
        return cls(np.ones(1), np.zeros((1, n)), np.eye(n)[None])

    def draw(self, size: int, random: np.random.RandomState) -> np.ndarray:
        """Draws, shape (size, n)."""
        component = random.choice(len(self.weight), size=size, p=self.weight)
        normal = random.standard_normal((size, self.mean.shape[1]))
        freedom = np.broadcast_to(self.freedom, len(self.weight))[component]
        stretch = np.sqrt(freedom / random.chisquare(freedom))
        coloured = np.einsum("wij,wj->wi", self.factor[component], stretch[:, None] * normal)
        return np.asarray(self.mean[component] + coloured)

    def log_densities(self, white: np.ndarray) -> np.ndarray:
        """Log of weight times density of each component, shape (point, component).

        Args:
            white: Whitened coordinates, shape (point, n).
        """
        nu, n = self.freedom, white.shape[1]
        log_det = np.log(np.diagonal(self.factor, axis1=1, axis2=2)).sum(1)
        constant = gammaln(0.5 * (nu + n)) - gammaln(0.5 * nu) - 0.5 * n * np.log(nu * np.pi)
        squared = self.squared_distances(white)
        return np.asarray(np.log(self.weight) + constant - log_det - 0.5 * (nu + n) * np.log1p(squared / nu))

    def squared_distances(self, white: np.ndarray) -> np.ndarray:
        """Squared Mahalanobis distance from each component, shape (point, component)."""
        inverse_factor = np.linalg.inv(self.factor)
        with np.errstate(over="ignore", invalid="ignore"):  # what a bend throws far out has no density
            standardised = (white - self.mean[:, None]) @ inverse_factor.swapaxes(1, 2)
            return np.asarray((standardised**2).sum(-1).T)


class MixtureProposal:
    """Mixture over tuples of counts: draws and log density, in NumPy for emcee.

    Args:
        mixture: Maximum and Laplace covariance of every tuple.
        bend: Map from whitened to straightened coordinates; the identity by default.
        shape: Distribution in the straightened coordinates; a standard Student-t by default.
        weight: Probability of each tuple, shape (tuple,); by default that of the mixture, with a share `FLOOR` spread evenly.
    """

    def __init__(
        self,
        mixture: CountMixture,
        bend: Bend | None = None,
        shape: WhiteShape | None = None,
        weight: np.ndarray | None = None,
    ) -> None:
        self.mixture = mixture
        self.counts = numpy_of(mixture.counts)
        self.mean = numpy_of(mixture.mean)
        self.factor = numpy_of(lower_factor(mixture.covariance))
        self.inverse_factor = np.linalg.inv(self.factor)
        self.n = self.mean.shape[1]
        self.bend = Bend.none(self.n) if bend is None else bend
        self.shape = WhiteShape.standard(self.n) if shape is None else shape
        if weight is None:
            weight = (1.0 - FLOOR) * numpy_of(mixture.weight) + FLOOR / len(self.counts)
        self.weight = weight / weight.sum()
        self._row = {tuple(row): i for i, row in enumerate(self.counts)}
        self._log_norm = np.log(self.weight) - np.log(np.diagonal(self.factor, axis1=1, axis2=2)).sum(1)

    def rows(self, vectors: np.ndarray) -> np.ndarray:
        """Row in the table of tuples for the counts of each vector."""
        return np.array([self._row[tuple(counts)] for counts in vectors[:, self.n :]], dtype=int)

    def draw(self, size: int, random: np.random.RandomState) -> np.ndarray:
        """Draw vectors from the mixture; far out in a bend they may overflow."""
        row = random.choice(len(self.weight), size=size, p=self.weight)
        continuous = self.from_straight(row, self.shape.draw(size, random))
        return np.concatenate((continuous, self.counts[row]), axis=1)

    def log_density(self, vectors: np.ndarray) -> np.ndarray:
        """Log density of the mixture at vectors whose counts are in the table."""
        row = self.rows(vectors)
        log_densities = self.shape.log_densities(self.straight(row, vectors))
        return np.asarray(self._log_norm[row] + logsumexp(log_densities, axis=1))

    def straight(self, row: np.ndarray, vectors: np.ndarray) -> np.ndarray:
        """Continuous coordinates, whitened by the mean and Laplace covariance of their tuple, then straightened."""
        return self.bend.straightened(self.white(row, vectors))

    def white(self, row: np.ndarray, vectors: np.ndarray) -> np.ndarray:
        """Continuous coordinates, whitened by the mean and Laplace covariance of their tuple."""
        return np.asarray(
            np.einsum("wij,wj->wi", self.inverse_factor[row], vectors[:, : self.n] - self.mean[row])
        )

    def from_straight(self, row: np.ndarray, straight: np.ndarray) -> np.ndarray:
        """Continuous coordinates of points in straightened ones, the inverse of `straight`."""
        with np.errstate(over="ignore", invalid="ignore"):
            coloured = np.einsum("wij,wj->wi", self.factor[row], self.bend.bent(straight))
            return np.asarray(self.mean[row] + coloured)
