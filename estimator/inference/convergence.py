"""Convergence of the ensemble: effective sample size and rank-normalised R-hat of every coordinate.

These are ArviZ's numbers. Importing ArviZ would take as long as the sampling of a small session.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import ndtri

FEWEST_STEPS = 8
TAILS = (0.05, 0.95)
BLOM = 3 / 8  # offset of ranks (Blom, Statistical Estimates and Transformed Beta-Variables, 1958)


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

    References: Vehtari et al., Bayesian Analysis 16, 667 (2021).
    Examples:
        >>> noise = np.random.default_rng(0).normal(size=(200, 16, 1))
        >>> result = convergence(noise)
        >>> bool(result.smallest_ess > 2000 and result.largest_rhat < 1.01)
        True
    """
    steps, walkers, n = chain.shape
    values = np.full((3, n), np.nan)
    if steps >= FEWEST_STEPS:
        for i in range(n):
            series = chain[:, :, i].T
            if np.ptp(series) > 0.0:
                values[:, i] = _diagnostics(series)
    return Convergence(values[0], values[1], values[2], steps * walkers)


def _diagnostics(series: Float[np.ndarray, "walker step"]) -> tuple[float, float, float]:
    """Effective samples of bulk and tails, and R-hat."""
    halves = _halves(series)
    normal = _normal_scores(halves)
    folded = _normal_scores(np.abs(halves - np.median(halves)))
    tails = [_halves((series <= quantile).astype(float)) for quantile in np.quantile(series, TAILS)]
    return _ess(normal), min(map(_ess, tails)), max(_rhat(normal), _rhat(folded))


def _halves(series: Float[np.ndarray, "walker step"]) -> Float[np.ndarray, "chain half"]:
    """First and second half of each walker as chains of their own."""
    half = series.shape[1] // 2
    return np.concatenate((series[:, :half], series[:, -half:]))


def _normal_scores(chains: Float[np.ndarray, "chain step"]) -> Float[np.ndarray, "chain step"]:
    """Quantiles of the normal distribution at the ranks of values; equal values share their mean rank."""
    _, place, number = np.unique(chains, return_inverse=True, return_counts=True)
    rank = (np.cumsum(number) - 0.5 * (number - 1))[place.reshape(chains.shape)]
    scores: np.ndarray = ndtri((rank - BLOM) / (chains.size - 2 * BLOM + 1))
    return scores


def _rhat(chains: Float[np.ndarray, "chain step"]) -> float:
    """Square root of the total variance over that within chains."""
    steps = chains.shape[1]
    between, within = steps * chains.mean(axis=1).var(ddof=1), chains.var(axis=1, ddof=1).mean()
    # Infinite where walkers never move; halves of a chain in which a count never changes say nothing.
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(np.sqrt((between / within + steps - 1) / steps))


def _ess(chains: Float[np.ndarray, "chain step"]) -> float:
    """Effective samples, by the sum of autocorrelations up to the first pair that is negative."""
    if np.ptp(chains) < np.finfo(float).resolution:
        return float(chains.size)
    steps = chains.shape[1]
    covariance = _autocovariance(chains)
    within = covariance[0] * steps / (steps - 1)
    correlation = 1.0 - (within - covariance) / (covariance[0] + chains.mean(axis=1).var(ddof=1))
    correlation[0] = 1.0
    time = max(_correlation_time(correlation), 1 / np.log10(chains.size))
    return float(chains.size / time)


def _autocovariance(chains: Float[np.ndarray, "chain step"]) -> Float[np.ndarray, " lag"]:
    """Autocovariance by lag, the mean over chains."""
    steps = chains.shape[1]
    size = 1 << (2 * steps - 1).bit_length()  # zeros, so that the end does not meet the beginning
    spectrum = np.fft.rfft(chains - chains.mean(axis=1, keepdims=True), size)
    power = (np.abs(spectrum) ** 2).mean(axis=0)
    covariance: np.ndarray = np.fft.irfft(power, size)[:steps] / steps
    return covariance


def _correlation_time(correlation: Float[np.ndarray, " lag"]) -> float:
    """Integrated autocorrelation time in steps, from Geyer's initial monotone sequence.

    References: Geyer, Statist. Sci. 7, 473 (1992).
    """
    looked_at = correlation[: 2 * ((len(correlation) - 1) // 2)].reshape(-1, 2)
    pairs = looked_at.sum(axis=1)
    ending = np.flatnonzero(pairs <= 0.0)
    last = int(ending[0]) if len(ending) else len(pairs) - 1
    even = looked_at[last, 0] if pairs[last] >= 0.0 else max(looked_at[last, 0], 0.0)
    return float(-1.0 + 2.0 * np.minimum.accumulate(pairs[:last]).sum() + even)
