"""Moves for emcee that use a proposal over loop counts and coordinates.

A fresh draw is a tuple of counts and, around its maximum, coordinates. It does not depend on the walker, so a good approximation gives
nearly independent samples, and draws for many steps are evaluated in one call (`MovesInBlocks`). `autoregressive_move` goes part of the
way and stays useful in many dimensions. `LatticeDifferenceMove` is emcee's differential evolution in coordinates whitened by the mean and
covariance of each tuple. It does not rely on the approximation and reaches what the mixture misses.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from emcee.model import Model
from emcee.moves import MHMove, Move, RedBlueMove
from emcee.state import State

from estimator.inference.proposal import MixtureProposal

# Shares of the steps: fresh draws, autoregressive, differential evolution. Draws evaluated together cost half of those of the other moves.
GOOD_SHARES, POOR_SHARES = (0.9, 0.05, 0.05), (0.7, 0.15, 0.15)
JITTER = 1e-3  # of differential evolution, in whitened coordinates
BLOCK = 16  # steps; draws of 32 walkers are 400 then, and more at once would cost no less each


class MovesInBlocks(Move):  # type: ignore[misc]  # emcee is untyped
    """One of three moves at each step, chosen at random for a block of steps at once.

    The fresh draws of a block are evaluated in one call. They come from random numbers that the seed and the number of the block decide,
    so that a chain which is continued in the middle of a block is that of an uninterrupted run.

    Args:
        proposal: What the moves propose from.
        seed: Seed of plans and fresh draws.
        step: Steps that the chain has already.
        shares: Probability of a fresh draw, of an autoregressive move and of differential evolution at each step.
    References: Tierney, Ann. Statist. 22, 1701 (1994), independence chains and mixtures of moves.
    """

    def __init__(
        self,
        proposal: MixtureProposal,
        seed: int,
        step: int = 0,
        shares: tuple[float, float, float] = POOR_SHARES,
    ) -> None:
        self.proposal, self.seed, self.step, self.shares = proposal, seed, step, shares
        self._dependent = (autoregressive_move(proposal), LatticeDifferenceMove(proposal))
        self._block: _Block | None = None

    def propose(self, model: Model, state: State) -> tuple[State, np.ndarray]:
        """Move every walker once."""
        number, i = divmod(self.step, BLOCK)
        if self._block is None or self._block.number != number:
            self._block = self._planned(number, state.coords, model)
        self.step += 1
        move = self._block.moves[i]
        if move > 0:
            return self._dependent[move - 1].propose(model, state)
        n_fresh = int((self._block.moves[:i] == 0).sum())
        fresh, log_prob, log_density = self._block.draws(n_fresh)
        log_ratio = log_prob - log_density - (state.log_prob - self.proposal.log_density(state.coords))
        accepted = np.log(model.random.rand(len(log_ratio))) < log_ratio
        return self.update(state, State(fresh, log_prob=log_prob), accepted), accepted

    def _planned(self, number: int, walkers: np.ndarray, model: Model) -> _Block:
        random = np.random.RandomState([self.seed, number])
        n_walkers = len(walkers)
        moves = random.choice(3, size=BLOCK, p=self.shares)
        n_fresh = int((moves == 0).sum())
        drawn = self.proposal.draw(n_fresh * n_walkers, random)
        fresh, is_somewhere = somewhere(drawn, np.tile(walkers, (n_fresh, 1)))
        log_prob = model.compute_log_prob_fn(fresh)[0] if len(fresh) else np.empty(0)
        log_density = self.proposal.log_density(fresh)
        # So far out in a bend that rounding leaves no density: accepted, such a draw would stay for ever.
        is_known = np.isfinite(log_density) & is_somewhere
        log_prob = np.where(is_known, log_prob, -np.inf)
        return _Block(number, n_walkers, moves, fresh, log_prob, np.where(is_known, log_density, 0.0))


@dataclass(frozen=True)
class _Block:
    """What is known of some steps ahead.

    Attributes:
        moves: Which move each step makes; 0 stands for a fresh draw.
        fresh: Draws for all steps that make it, `n_walkers` each.
        log_prob, log_density: Log densities of the posterior and of the proposal at them.
    """

    number: int
    n_walkers: int
    moves: np.ndarray
    fresh: np.ndarray
    log_prob: np.ndarray
    log_density: np.ndarray

    def draws(self, i: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Draws of the i-th step that makes fresh ones, with the log densities of posterior and proposal at them."""
        mine = slice(i * self.n_walkers, (i + 1) * self.n_walkers)
        return self.fresh[mine], self.log_prob[mine], self.log_density[mine]


def somewhere(fresh: np.ndarray, walkers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Proposals whose coordinates are numbers, and which of them were; the others stay where their walkers are, to be refused.

    A bend squares squares, so its far tails overflow. No density is asked there, and emcee refuses to ask one.

    Args:
        fresh: Proposed vectors, shape (point, coordinate).
        walkers: Where the walkers are.
    """
    is_somewhere = np.isfinite(fresh).all(1)
    return np.where(is_somewhere[:, None], fresh, walkers), is_somewhere


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
        fresh, is_somewhere = somewhere(fresh, vectors)
        with np.errstate(over="ignore", invalid="ignore"):
            factor = 0.5 * ((moved**2).sum(1) - (straight**2).sum(1))
        return fresh, np.where(is_somewhere & np.isfinite(factor), factor, -np.inf)

    return MHMove(propose)


class LatticeDifferenceMove(RedBlueMove):  # type: ignore[misc]  # emcee is untyped
    """Differential evolution within a walker's tuple of counts, in whitened coordinates.

    References: ter Braak, Stat. Comput. 16, 239 (2006); Nelson et al., ApJS 210, 11 (2014).
    """

    def __init__(self, proposal: MixtureProposal, **options: Any) -> None:
        super().__init__(**options)
        self.proposal = proposal

    def get_proposal(
        self, moved: np.ndarray, others: list[np.ndarray], random: np.random.RandomState
    ) -> tuple[np.ndarray, np.ndarray]:
        """Shift each walker by the difference of two others; symmetric, so the factors are 0."""
        complement = np.concatenate(others)
        straight = self.proposal.straight(self.proposal.rows(complement), complement)
        first = random.randint(len(straight), size=len(moved))
        second = (first + random.randint(1, len(straight), size=len(moved))) % len(straight)
        scale = 2.38 / np.sqrt(2.0 * self.proposal.n) * random.choice([1.0, 0.4], size=(len(moved), 1))
        with np.errstate(over="ignore", invalid="ignore"):
            step = scale * (straight[first] - straight[second])
            step += JITTER * random.standard_normal(step.shape)
            row = self.proposal.rows(moved)
            shifted = self.proposal.straight(row, moved) + step
        fresh = moved.copy()
        fresh[:, : self.proposal.n] = self.proposal.from_straight(row, shifted)
        fresh, is_somewhere = somewhere(fresh, moved)
        return fresh, np.where(is_somewhere, 0.0, -np.inf)
