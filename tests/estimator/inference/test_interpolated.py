"""Interpolated residuals: the density of all readings where they are polynomials; that density itself elsewhere."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch

from estimator.inference import interpolated
from estimator.inference.interpolated import LARGEST_ERROR, InterpolatedPosterior, for_sampling
from estimator.inference.lattice import CountMixture, count_mixture
from estimator.inference.levenberg_marquardt import levenberg_marquardt
from tests.estimator.inference.conftest import Problem


def mixture_of(problem: Problem) -> CountMixture:
    fit = levenberg_marquardt(problem.real, problem.real.coordinates.start()[None])
    mixture = count_mixture(problem.real, problem.whole, fit, np.random.default_rng(0))
    assert mixture is not None
    return mixture


@pytest.fixture
def few_are_many(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(interpolated, "FEWEST_COMPONENTS", 1)


@pytest.fixture(scope="module")
def two_sensors(problem: Callable[..., Problem]) -> Problem:
    """Sensors with noise of their own, which is free, about a coil that moves and tilts."""
    noise = "noise_uT: {prior: {log_normal: {median: 1, relative_sd: 0.7}}}"
    pose = "{x_mm: {prior: {normal: {mean: 0, sd: 3}}}, tilt_y_deg: {prior: {normal: {mean: 0, sd: 2}}}, z_mm: -35}"
    return problem(
        f"{{coil1: {{radius_mm: {{prior: {{normal: {{mean: 50, sd: 2}}}}}}, wire_radius_mm: 1, axial_loops: 6, radial_loops: 4, "
        f"world_from_coil: {pose}}}}}",
        f"{{left: {{carried_by: stage, {noise}}}, right: {{carried_by: stage, flange_from_sensor: {{y_mm: 9}}, {noise}}}}}",
        {"coil1.radius_m": 0.0508, "coil1.world_from_coil.x_m": 0.001},
        noise_T=1e-6,
    )


@pytest.mark.usefixtures("few_are_many")
def test_density_is_that_of_all_readings(two_sensors):
    sampled = for_sampling(two_sensors.whole, mixture_of(two_sensors), seed=1)
    assert isinstance(sampled, InterpolatedPosterior)
    vectors = sampled.drawn_about(200, 1.0, torch.Generator().manual_seed(9))
    expected = two_sensors.whole(vectors)
    assert expected.std() > 20.0 * LARGEST_ERROR
    torch.testing.assert_close(sampled(vectors), expected, rtol=0.0, atol=2.0 * LARGEST_ERROR)
    torch.testing.assert_close(sampled(vectors[0]), sampled(vectors)[0])


@pytest.mark.usefixtures("few_are_many")
def test_vectors_with_other_counts_have_the_density_itself(counts_problem):
    sampled = for_sampling(counts_problem.whole, mixture_of(counts_problem), seed=1)
    assert isinstance(sampled, InterpolatedPosterior)
    vectors = sampled.drawn_about(6, 1.0, torch.Generator().manual_seed(2))
    vectors[::2, -1] += 1.0
    expected = counts_problem.whole(vectors)
    torch.testing.assert_close(sampled(vectors)[::2], expected[::2], rtol=1e-12, atol=0.0)
    torch.testing.assert_close(sampled(vectors), expected, rtol=0.0, atol=LARGEST_ERROR)


@pytest.mark.usefixtures("few_are_many")
def test_what_is_no_polynomial_is_not_interpolated(problem):
    bent = problem(
        "{coil1: {radius_mm: 50, wire_radius_mm: 1, axial_loops: 3, radial_loops: 2, "
        "world_from_coil: {z_mm: {prior: {normal: {mean: -40, sd: 8}}}}}}",
        "{hall: {noise_uT: 300, carried_by: stage}}",
        noise_T=300e-6,
    )
    assert for_sampling(bent.whole, mixture_of(bent), seed=1) is bent.whole


def test_few_readings_are_not_interpolated(two_sensors):
    assert for_sampling(two_sensors.whole, mixture_of(two_sensors), seed=1) is two_sensors.whole
