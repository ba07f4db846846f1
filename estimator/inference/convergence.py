"""Convergence of the ensemble: effective sample size and rank-normalised R-hat of every coordinate, from ArviZ."""

from __future__ import annotations

import importlib
import os
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import ModuleType

import numpy as np

FEWEST_STEPS = 8
CACHE = "XDG_CACHE_HOME"


@dataclass(frozen=True)
class Convergence:
    """Diagnostics of each coordinate; NaN for one that never moved (a count with probability 1).

    Attributes:
        ess_bulk, ess_tail: Effective sample sizes of the bulk and of the 5 % tails, over all walkers.
        rhat: Rank-normalised split R-hat over walkers.
        autocorrelation_steps: Integrated autocorrelation time, n_samples / ess_bulk.
    """

    ess_bulk: np.ndarray
    ess_tail: np.ndarray
    rhat: np.ndarray
    n_samples: int

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

    References: Vehtari et al., Bayesian Analysis 16, 667 (2021), as implemented in ArviZ.
    Examples:
        >>> noise = np.random.default_rng(0).normal(size=(200, 16, 1))
        >>> result = convergence(noise)
        >>> bool(result.smallest_ess > 2000 and result.largest_rhat < 1.01)
        True
    """
    arviz = _arviz()
    steps, walkers, n = chain.shape
    values = np.full((3, n), np.nan)
    if steps >= FEWEST_STEPS:
        for i in range(n):
            series = chain[:, :, i].T
            if np.ptp(series) > 0.0:
                # R-hat is infinite where walkers never move; halves of a chain in which a count never changes say nothing.
                with np.errstate(divide="ignore", invalid="ignore"):
                    values[0, i] = arviz.ess(series, method="bulk")
                    values[1, i] = arviz.ess(series, method="tail")
                    values[2, i] = arviz.rhat(series, method="rank")
    return Convergence(values[0], values[1], values[2], steps * walkers)


def _arviz() -> ModuleType:
    """ArviZ; half a second when it is first imported, spent only by commands that sample.

    It announces its 1.x line, and notes that in the user's cache. A service may run as a user who has none that can be written.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)
        try:
            return importlib.import_module("arviz")
        except (OSError, RuntimeError):
            with tempfile.TemporaryDirectory() as folder, _cache_in(folder):
                return importlib.import_module("arviz")


@contextmanager
def _cache_in(folder: str) -> Iterator[None]:
    before = os.environ.get(CACHE)
    os.environ[CACHE] = folder
    try:
        yield
    finally:
        del os.environ[CACHE]
        if before is not None:
            os.environ[CACHE] = before
