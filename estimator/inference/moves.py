"""Moves for emcee that use the Laplace mixture over loop counts.

`independence_move` draws a tuple of counts and, around its maximum, Student-t distributed coordinates. The draw does not depend on the
walker, so a good approximation gives nearly independent samples. `autoregressive_move` goes part of the way and stays useful in many
dimensions. `LatticeDifferenceMove` is emcee's differential evolution in coordinates whitened by the mean and covariance of each tuple. It
does not rely on the approximation and reaches what the mixture misses.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from emcee.moves import MHMove, RedBlueMove
from scipy.special import gammaln

from estimator.inference.lattice import CountMixture

DEGREES_OF_FREEDOM = 12.0
FLOOR = 0.05  # share of proposals spread evenly over all tuples, so that each is proposed now and then


class MixtureProposal:
    """Student-t mixture over tuples of counts: draws and log density, in NumPy for emcee."""

    def __init__(self, mixture: CountMixture) -> None:
        self.counts = mixture.counts.numpy()
        self.mean = mixture.mean.numpy()
        self.factor = np.linalg.cholesky(mixture.covariance.numpy())
        self.inverse_factor = np.linalg.inv(self.factor)
        weight = (1.0 - FLOOR) * mixture.weight.numpy() + FLOOR / len(self.counts)
        self.weight = weight / weight.sum()
        self.n = self.mean.shape[1]
        self._row = {tuple(row): i for i, row in enumerate(self.counts)}
        log_det = np.log(np.diagonal(self.factor, axis1=1, axis2=2)).sum(1)
        nu, n = DEGREES_OF_FREEDOM, self.n
        constant = gammaln(0.5 * (nu + n)) - gammaln(0.5 * nu) - 0.5 * n * np.log(nu * np.pi)
        self._log_norm = np.log(self.weight) + constant - log_det

    def rows(self, vectors: np.ndarray) -> np.ndarray:
        """Row in the table of tuples for the counts of each vector."""
        return np.array([self._row[tuple(counts)] for counts in vectors[:, self.n :]], dtype=int)

    def draw(self, size: int, random: np.random.RandomState) -> np.ndarray:
        """Draw vectors from the mixture."""
        row = random.choice(len(self.weight), size=size, p=self.weight)
        normal = random.standard_normal((size, self.n))
        stretch = np.sqrt(DEGREES_OF_FREEDOM / random.chisquare(DEGREES_OF_FREEDOM, size))
        continuous = self.mean[row] + self.colour(row, stretch[:, None] * normal)
        return np.concatenate((continuous, self.counts[row]), axis=1)

    def log_density(self, vectors: np.ndarray) -> np.ndarray:
        """Log density of the mixture at vectors whose counts are in the table."""
        row = self.rows(vectors)
        squared = (self.whiten(row, vectors) ** 2).sum(1)
        exponent = -0.5 * (DEGREES_OF_FREEDOM + self.n)
        return np.asarray(self._log_norm[row] + exponent * np.log1p(squared / DEGREES_OF_FREEDOM))

    def whiten(self, row: np.ndarray, vectors: np.ndarray) -> np.ndarray:
        """Continuous coordinates, whitened by the mean and Laplace covariance of their tuple."""
        return np.asarray(
            np.einsum("wij,wj->wi", self.inverse_factor[row], vectors[:, : self.n] - self.mean[row])
        )

    def colour(self, row: np.ndarray, white: np.ndarray) -> np.ndarray:
        """Inverse of the linear part of `whiten`."""
        return np.asarray(np.einsum("wij,wj->wi", self.factor[row], white))


def independence_move(proposal: MixtureProposal) -> MHMove:
    """Metropolis-Hastings move of all walkers to fresh draws from the mixture.

    References: Tierney, Ann. Statist. 22, 1701 (1994), independence chains.
    """

    def propose(vectors: np.ndarray, random: np.random.RandomState) -> tuple[np.ndarray, np.ndarray]:
        fresh = proposal.draw(len(vectors), random)
        return fresh, proposal.log_density(vectors) - proposal.log_density(fresh)

    return MHMove(propose)


def autoregressive_move(proposal: MixtureProposal) -> MHMove:
    """Move every walker part of the way to a fresh normal draw of its own tuple: mean + sqrt(1 - b^2) (x - mean) + b noise.

    The move leaves the Laplace normal invariant. Its acceptance depends on how normal the posterior is, not on the dimension. b is drawn
    log-uniformly from 0.05 to 1; small values free walkers that fresh draws cannot move.

    References: Cotter et al., Statist. Sci. 28, 424 (2013), preconditioned Crank-Nicolson.
    """

    def propose(vectors: np.ndarray, random: np.random.RandomState) -> tuple[np.ndarray, np.ndarray]:
        row = proposal.rows(vectors)
        white = proposal.whiten(row, vectors)
        b = 10.0 ** random.uniform(np.log10(0.05), 0.0, size=(len(vectors), 1))
        moved = np.sqrt(1.0 - b**2) * white + b * random.standard_normal(white.shape)
        fresh = vectors.copy()
        fresh[:, : proposal.n] = proposal.mean[row] + proposal.colour(row, moved)
        return fresh, 0.5 * ((moved**2).sum(1) - (white**2).sum(1))

    return MHMove(propose)


class LatticeDifferenceMove(RedBlueMove):  # type: ignore[misc]  # emcee is untyped
    """Differential evolution within a walker's tuple of counts, in whitened coordinates.

    References: ter Braak, Stat. Comput. 16, 239 (2006); Nelson et al., ApJS 210, 11 (2014).
    """

    def __init__(self, proposal: MixtureProposal, jitter: float = 1e-3, **options: Any) -> None:
        super().__init__(**options)
        self.proposal, self.jitter = proposal, jitter

    def get_proposal(
        self, moved: np.ndarray, others: list[np.ndarray], random: np.random.RandomState
    ) -> tuple[np.ndarray, np.ndarray]:
        """Shift each walker by the difference of two others; symmetric, so the factors are 0."""
        complement = np.concatenate(others)
        white = self.proposal.whiten(self.proposal.rows(complement), complement)
        first = random.randint(len(white), size=len(moved))
        second = (first + random.randint(1, len(white), size=len(moved))) % len(white)
        scale = 2.38 / np.sqrt(2.0 * self.proposal.n) * random.choice([1.0, 0.4], size=(len(moved), 1))
        step = scale * (white[first] - white[second])
        step += self.jitter * random.standard_normal(step.shape)
        fresh = moved.copy()
        fresh[:, : self.proposal.n] += self.proposal.colour(self.proposal.rows(moved), step)
        return fresh, np.zeros(len(moved))
