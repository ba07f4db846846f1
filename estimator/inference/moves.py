"""Moves for emcee that use a proposal over loop counts and coordinates.

`independence_move` draws a tuple of counts and, around its maximum, coordinates. The draw does not depend on the
walker, so a good approximation gives nearly independent samples. `autoregressive_move` goes part of the way and stays useful in many
dimensions. `LatticeDifferenceMove` is emcee's differential evolution in coordinates whitened by the mean and covariance of each tuple. It
does not rely on the approximation and reaches what the mixture misses.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from emcee.moves import MHMove, RedBlueMove

from estimator.inference.proposal import MixtureProposal


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
        straight = proposal.straight(row, vectors)
        b = 10.0 ** random.uniform(np.log10(0.05), 0.0, size=(len(vectors), 1))
        moved = np.sqrt(1.0 - b**2) * straight + b * random.standard_normal(straight.shape)
        fresh = vectors.copy()
        fresh[:, : proposal.n] = proposal.from_straight(row, moved)
        return fresh, 0.5 * ((moved**2).sum(1) - (straight**2).sum(1))

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
        straight = self.proposal.straight(self.proposal.rows(complement), complement)
        first = random.randint(len(straight), size=len(moved))
        second = (first + random.randint(1, len(straight), size=len(moved))) % len(straight)
        scale = 2.38 / np.sqrt(2.0 * self.proposal.n) * random.choice([1.0, 0.4], size=(len(moved), 1))
        step = scale * (straight[first] - straight[second])
        step += self.jitter * random.standard_normal(step.shape)
        row = self.proposal.rows(moved)
        fresh = moved.copy()
        fresh[:, : self.proposal.n] = self.proposal.from_straight(
            row, self.proposal.straight(row, moved) + step
        )
        return fresh, np.zeros(len(moved))
