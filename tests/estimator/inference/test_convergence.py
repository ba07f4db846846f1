"""Diagnostics on chains whose effective size is known."""

from __future__ import annotations

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


def test_worst_coordinate_decides():
    chain = np.concatenate(
        (autoregressive(0.0, 1000, 8, seed=2), autoregressive(0.9, 1000, 8, seed=3)), axis=-1
    )
    diagnostics = convergence(chain)
    assert diagnostics.smallest_ess == min(diagnostics.ess_bulk.min(), diagnostics.ess_tail.min())
    assert diagnostics.smallest_ess < 0.2 * diagnostics.ess_bulk[0]
    assert diagnostics.largest_rhat == diagnostics.rhat[1]


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
def test_numbers_are_those_of_arviz(steps, correlation, shaped):
    chain = shaped(autoregressive(correlation, steps, 6))
    diagnostics, series = convergence(chain), chain[:, :, 0].T
    own = (diagnostics.ess_bulk[0], diagnostics.ess_tail[0], diagnostics.rhat[0])
    theirs = (
        arviz.ess(series, method="bulk"),
        arviz.ess(series, method="tail"),
        arviz.rhat(series, method="rank"),
    )
    assert own == pytest.approx([float(number) for number in theirs], rel=1e-9)


def test_a_count_that_changes_once_for_all_walkers_is_no_fault():
    """Each half of the chain is constant; warnings are errors here."""
    chain = np.zeros((200, 8, 1))
    chain[:100] = 1.0
    assert not convergence(chain).largest_rhat < 1.01
