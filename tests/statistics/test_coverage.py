"""Posteriors are calibrated, and the check would notice if they were not.

A small version of `make coverage`; bounds are the Monte Carlo error of so few repeats.
"""

from __future__ import annotations

import pytest
from scipy import stats

from tests.statistics.coverage import count_calibration, coverage90, one_repeat, paper_rig, uniformity

REPEATS = 40


@pytest.fixture(scope="module")
def repeats():
    return [one_repeat(seed, target_ess=400.0) for seed in range(REPEATS)]


@pytest.mark.slow
def test_intervals_hold_the_truth_as_often_as_they_say(repeats):
    low, high = stats.binom.interval(0.999, REPEATS, 0.9)
    for name, share in coverage90(repeats).items():
        assert low <= share * REPEATS <= high, f"{name}: {share:.0%}"


@pytest.mark.slow
def test_ranks_of_the_truth_are_uniform(repeats):
    for name, p_value in uniformity(repeats).items():
        assert p_value > 1e-4, name


@pytest.mark.slow
def test_loop_counts_are_true_as_often_as_they_say(repeats):
    for row in count_calibration(repeats, n_bins=2):
        assert abs(row["z"]) < 4.0, row


@pytest.mark.slow
def test_a_noise_believed_too_small_is_noticed():
    believed = paper_rig().with_values({"hall.noise_T": 8e-6}).with_fixed(["hall.noise_T"])
    repeats = [one_repeat(seed, target_ess=400.0, fitted_rig=believed) for seed in range(REPEATS)]
    low, _ = stats.binom.interval(0.999, REPEATS, 0.9)
    assert min(share * REPEATS for share in coverage90(repeats).values()) < low
