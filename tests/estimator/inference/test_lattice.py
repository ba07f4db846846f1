"""The table of loop counts against a posterior worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from estimator.inference import lattice
from estimator.inference.lattice import CountMixture, count_mixture
from estimator.inference.levenberg_marquardt import Optimum, levenberg_marquardt


@pytest.fixture(scope="module")
def fit(counts_problem) -> Optimum:
    return levenberg_marquardt(counts_problem.real, counts_problem.real.coordinates.start()[None])


@pytest.fixture(scope="module")
def mixture(counts_problem, fit) -> CountMixture:
    return mixture_of(counts_problem, fit)


def mixture_of(counts_problem, fit: Optimum, seed: int = 0) -> CountMixture:
    result = count_mixture(counts_problem.real, counts_problem.whole, fit, np.random.default_rng(seed))
    assert result is not None
    return result


def by_counts(mixture: CountMixture) -> dict[tuple[int, int], float]:
    keys = [(int(axial), int(radial)) for axial, radial in mixture.counts.tolist()]
    return dict(zip(keys, mixture.weight.tolist(), strict=True))


def test_weights_are_the_probabilities_of_the_counts(mixture, exact_counts):
    """As near as Laplace's approximation comes: a tenth of each."""
    weights = by_counts(mixture)
    assert sum(weights.values()) == pytest.approx(1.0, abs=1e-12)
    likely = {key: p for key, p in exact_counts.probability.items() if p > 1e-3}
    assert len(likely) >= 5
    for key, probability in likely.items():
        assert weights[key] == pytest.approx(probability, rel=0.15), key


def test_table_holds_all_that_matters_and_little_else(mixture, exact_counts):
    weights = by_counts(mixture)
    assert {key for key, p in exact_counts.probability.items() if p > 3e-5} <= set(weights)
    assert min(weights.values()) > 1e-5
    assert len(weights) < 20


def test_components_are_the_maxima_and_widths_of_their_counts(counts_problem, mixture):
    vectors = torch.cat((mixture.mean, mixture.counts), -1)
    fits = levenberg_marquardt(counts_problem.whole, vectors)
    torch.testing.assert_close(fits.vector, vectors, rtol=1e-3, atol=1e-4)
    torch.testing.assert_close(torch.linalg.inv(fits.precision), mixture.covariance, rtol=1e-2, atol=1e-8)
    assert (fits.log_posterior - counts_problem.whole(vectors)).abs().max() < 1e-3


def test_without_free_counts_there_is_one_component(linear_problem):
    fit = levenberg_marquardt(linear_problem.real, linear_problem.real.coordinates.start()[None])
    result = count_mixture(linear_problem.real, linear_problem.whole, fit, np.random.default_rng(0))
    assert result is not None
    assert (result.counts.shape, result.weight.tolist()) == ((1, 0), [1.0])
    torch.testing.assert_close(result.mean, fit.vector, rtol=1e-9, atol=0.0)
    torch.testing.assert_close(
        result.covariance[0], torch.linalg.inv(fit.precision[0]), rtol=1e-6, atol=1e-15
    )


def test_counts_never_fall_below_one(problem):
    """A single layer of a single turn, and readings so noisy that the neighbours all matter."""
    simulated = problem(
        """{coil1: {radius_mm: 50, wire_radius_mm: 1, axial_loops: {prior: {normal: {mean: 2, sd: 1, lower: 1}}},
  radial_loops: {prior: {normal: {mean: 1, sd: 0.7, lower: 1}}}, world_from_coil: {z_mm: {prior: {normal: {mean: -35, sd: 1}}}}}}""",
        "{hall: {noise_uT: 40, carried_by: stage}}",
        noise_T=40e-6,
    )
    fit = levenberg_marquardt(simulated.real, simulated.real.coordinates.start()[None])
    result = count_mixture(simulated.real, simulated.whole, fit, np.random.default_rng(0))
    assert result is not None
    assert result.counts.min() == 1.0
    assert len(result.counts) > 4


@pytest.mark.parametrize("limit", ["MOST_TUPLES", "MOST_EFFECTIVE"])
def test_counts_that_the_readings_hardly_determine_get_no_table(counts_problem, fit, monkeypatch, limit):
    monkeypatch.setattr(lattice, limit, 3)
    random = np.random.default_rng(0)
    assert count_mixture(counts_problem.real, counts_problem.whole, fit, random) is None
