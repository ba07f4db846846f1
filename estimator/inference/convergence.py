"""Convergence of the ensemble: effective sample size and rank-normalised R-hat of every coordinate, from ArviZ's own core."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

FEWEST_STEPS = 8
TAILS = (0.05, 0.95)


@dataclass(frozen=True)
class Convergence:
    """Diagnostics of each coordinate; NaN for one that never moved (a count with probability 1).

    Attributes:
        ess_bulk, ess_tail: Effective sample sizes of the bulk and of the 5 % tails, over all walkers.
        rhat: Rank-normalised split R-hat over walkers.
    """

    ess_bulk: np.ndarray
    ess_tail: np.ndarray
    rhat: np.ndarray

    @property
    def smallest_ess(self) -> float:
        """The smallest effective sample size over coordinates that moved; 0 if none did."""
        ess = np.concatenate((self.ess_bulk, self.ess_tail))
        return float(np.nanmin(ess)) if np.isfinite(ess).any() else 0.0

    @property
    def largest_rhat(self) -> float:
        """The largest R-hat over coordinates that moved; infinite if none did."""
        return float(np.nanmax(self.rhat)) if np.isfinite(self.rhat).any() else np.inf


def convergence(chain: np.ndarray) -> Convergence:
    """Diagnostics of samples with axes step, walker and coordinate; every walker counts as a chain.

    References: Vehtari et al., Bayesian Analysis 16, 667 (2021), as implemented in arviz-stats.
    Examples:
        >>> noise = np.random.default_rng(0).normal(size=(200, 16, 1))
        >>> result = convergence(noise)
        >>> bool(result.smallest_ess > 2000 and result.largest_rhat < 1.01)
        True
    """
    from arviz_stats.base.array import array_stats  # half a second, spent only by commands that sample

    steps, _, n = chain.shape
    values = np.full((3, n), np.nan)
    has_moved = np.ptp(chain, axis=(0, 1)) > 0.0
    if steps >= FEWEST_STEPS and has_moved.any():
        axes = {"chain_axis": 1, "draw_axis": 0}
        moved = chain[:, :, has_moved]
        # R-hat is infinite where walkers never move; halves of a chain in which a count never changes say nothing.
        with np.errstate(divide="ignore", invalid="ignore"):
            values[0, has_moved] = array_stats.ess(moved, **axes, method="bulk")
            values[1, has_moved] = array_stats.ess(moved, **axes, method="tail", prob=TAILS)
            values[2, has_moved] = array_stats.rhat(moved, **axes, method="rank")
    return Convergence(*values)
