"""Diagnostics on chains whose effective size is known."""

from __future__ import annotations

from collections.abc import Callable

import arviz
import numpy as np
import pytest
from scipy.signal import lfilter

from estimator.inference.convergence import FEWEST_STEPS, Convergence, convergence


def autoregressive(correlation: float, steps: int, walkers: int, seed: int = 0) -> np.ndarray:
    """Unit variance, correlation ** lag: an effective sample is (1 + correlation) / (1 - correlation) steps."""
    noise = np.random.default_rng(seed).normal(size=(steps + 300, walkers, 1))
    scale = np.sqrt(1.0 - correlation**2)
    return lfilter([scale], [1.0, -correlation], noise, axis=0)[300:]


def test_independent_draws_count_fully():
    diagnostics = convergence(np.random.default_rng(1).normal(size=(400, 20, 3)))
    assert diagnostics.ess_bulk == pytest.approx(8000, rel=0.1)
    assert diagnostics.largest_rhat < 1.01


@pytest.mark.parametrize("correlation", [0.5, 0.9])
def test_correlated_draws_count_as_many_as_theory_says(correlation):
    diagnostics = convergence(autoregressive(correlation, 3000, 16))
    expected = 3000 * 16 * (1.0 - correlation) / (1.0 + correlation)
    assert diagnostics.ess_bulk[0] == pytest.approx(expected, rel=0.12)


def test_worst_coordinate_decides():
    chain = np.concatenate(
        (autoregressive(0.0, 1000, 8, seed=2), autoregressive(0.9, 1000, 8, seed=3)), axis=-1
    )
    diagnostics = convergence(chain)
    assert diagnostics.smallest_ess == min(diagnostics.ess_bulk.min(), diagnostics.ess_tail.min())
    assert diagnostics.smallest_ess < 0.2 * diagnostics.ess_bulk[0]
    assert diagnostics.largest_rhat == diagnostics.rhat[1]


def test_walkers_that_do_not_mix_are_seen():
    chain = np.random.default_rng(4).normal(size=(500, 10, 1)) + 3.0 * np.arange(10)[None, :, None]
    diagnostics = convergence(chain)
    assert diagnostics.largest_rhat > 1.5
    assert diagnostics.smallest_ess < 50


def test_drift_over_time_is_seen_although_walkers_agree():
    chain = np.random.default_rng(5).normal(size=(500, 10, 1)) + np.linspace(0.0, 4.0, 500)[:, None, None]
    assert convergence(chain).largest_rhat > 1.2


def test_tails_that_mix_slower_than_the_bulk_are_seen():
    """Signs flip at every step, so the mean is known well, but large and small magnitudes alternate slowly."""
    slow = np.exp(1.5 * autoregressive(0.98, 4000, 8, seed=6))
    diagnostics = convergence(slow * np.random.default_rng(7).choice([-1.0, 1.0], size=slow.shape))
    assert diagnostics.ess_tail[0] < 0.3 * diagnostics.ess_bulk[0]
    assert diagnostics.smallest_ess == diagnostics.ess_tail[0]


def test_coordinate_that_never_moved_is_left_out():
    chain = np.random.default_rng(8).normal(size=(200, 8, 2))
    chain[:, :, 1] = 25.0
    diagnostics = convergence(chain)
    assert np.isnan([diagnostics.ess_bulk[1], diagnostics.ess_tail[1], diagnostics.rhat[1]]).all()
    assert diagnostics.smallest_ess == min(diagnostics.ess_bulk[0], diagnostics.ess_tail[0])
    assert diagnostics.largest_rhat == diagnostics.rhat[0]


@pytest.mark.parametrize(
    "chain", [np.ones((50, 4, 2)), np.random.default_rng(9).normal(size=(FEWEST_STEPS - 1, 4, 2))]
)
def test_nothing_moved_or_too_short_is_no_convergence(chain):
    diagnostics = convergence(chain)
    assert isinstance(diagnostics, Convergence)
    assert (diagnostics.smallest_ess, diagnostics.largest_rhat) == (0.0, np.inf)


def test_shortest_chain_that_is_looked_at_has_numbers():
    assert convergence(np.random.default_rng(10).normal(size=(FEWEST_STEPS, 4, 1))).smallest_ess > 0.0


@pytest.mark.parametrize("steps", [FEWEST_STEPS, 9, 51, 400])
@pytest.mark.parametrize("correlation", [0.0, 0.9, -0.9])
@pytest.mark.parametrize("shaped", [np.asarray, np.round, np.exp], ids=["normal", "whole numbers", "skew"])
def test_numbers_are_those_of_arviz(
    steps: int, correlation: float, shaped: Callable[[np.ndarray], np.ndarray]
) -> None:
    chain = shaped(autoregressive(correlation, steps, 6))
    diagnostics, series = convergence(chain), chain[:, :, 0].T
    own = (diagnostics.ess_bulk[0], diagnostics.ess_tail[0], diagnostics.rhat[0])
    theirs = (
        arviz.ess(series, method="bulk"),
        arviz.ess(series, method="tail"),
        arviz.rhat(series, method="rank"),
    )
    assert own == pytest.approx([float(number) for number in theirs], rel=1e-9)


def test_a_count_that_changes_once_for_all_walkers_is_no_fault() -> None:
    """Each half of the chain is constant; warnings are errors here."""
    chain = np.zeros((200, 8, 1))
    chain[:100] = 1.0
    assert not convergence(chain).largest_rhat < 1.01
