"""Causes of scatter: the likelihood against densities written with SciPy, and against readings that scatter so."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy import stats

from estimator.effects import EFFECTS
from estimator.effects.circumstances import Circumstances
from estimator.inference.likelihood import LogPosterior
from estimator.readings.observations import Observations
from estimator.rig.coordinates import Coordinates
from estimator.rig_files.read import rig_from_text
from tests.physics.effects.laboratory import (
    POINTS_M,
    RIG,
    MeasurementModel,
    effects_text,
    predicted_T,
    readings,
    winding,
)

# One number must be free for there to be a density; it stays at its nominal value.
FREE = RIG.replace("radius_mm: 40", "radius_mm: {prior: {normal: {mean: 40, sd: 1}}}")
NOISE_T, CURRENT_A = 5e-6, 20.0
RANDOM = np.random.default_rng(8)
ERROR_T = NOISE_T * RANDOM.standard_t(2.0, (len(POINTS_M), 3))


def measured(error_T: np.ndarray = ERROR_T) -> Observations:
    observations = readings(POINTS_M, (CURRENT_A, 0.0))
    return observations.with_field(torch.from_numpy(predicted_T(observations) + error_T))


def posterior(observations: Observations, effects: dict[str, dict[str, float]]) -> LogPosterior:
    rig = rig_from_text(FREE + effects_text(effects))
    return LogPosterior(Coordinates(rig), MeasurementModel.build(rig, observations, 1e-13), observations)


def log_likelihood(observations: Observations, effects: dict[str, dict[str, float]]) -> float:
    density = posterior(observations, effects)
    return float(density.log_likelihood(density.coordinates.start()))


def gradients() -> np.ndarray:
    """Length of the gradient of each component along the mover's axes, by differences of magpylib's field."""
    step_m = 1e-5
    slopes = [
        (winding().field_T(POINTS_M + step_m * e) - winding().field_T(POINTS_M - step_m * e)) / (2.0 * step_m)
        for e in np.eye(3)
    ]
    return CURRENT_A * np.linalg.norm(slopes, axis=0)


@pytest.mark.parametrize(("share", "ratio"), [(0.05, 10.0), (0.3, 3.0), (0.0, 1.0)])
def test_outliers_make_the_density_a_mixture_of_two_normals(share, ratio):
    effects = {"outliers[probe]": {"share": share, "ratio": ratio}}
    expected = np.log(
        (1.0 - share) * stats.norm.pdf(ERROR_T, scale=NOISE_T)
        + share * stats.norm.pdf(ERROR_T, scale=ratio * NOISE_T)
    ).sum()
    assert log_likelihood(measured(), effects) == pytest.approx(expected, rel=1e-9)


def test_outlier_weighs_as_much_as_the_probability_that_it_is_none():
    share, ratio = 0.1, 8.0
    density = posterior(measured(), {"outliers[probe]": {"share": share, "ratio": ratio}})
    vector = density.coordinates.start()
    good = (1.0 - share) * stats.norm.pdf(ERROR_T, scale=NOISE_T)
    bad = share * stats.norm.pdf(ERROR_T, scale=ratio * NOISE_T)
    expected = (good + bad / ratio**2) / (good + bad)
    weight = density.weight(density.whitened(vector), vector)
    np.testing.assert_allclose(weight.numpy(), expected.ravel(), rtol=1e-6)


def test_jitter_of_the_mover_adds_its_share_of_the_gradient_to_the_noise():
    sd_m = 3e-5
    effects = {"position_jitter[mapper]": {"sd_m": sd_m}}
    scale = np.hypot(NOISE_T, sd_m * gradients())
    assert (scale > 1.3 * NOISE_T).any()
    expected = stats.norm.logpdf(ERROR_T, scale=scale).sum()
    assert log_likelihood(measured(), effects) == pytest.approx(expected, rel=1e-7)


def test_noise_that_grows_adds_a_share_of_each_component_to_the_noise():
    share = 0.004
    scale = np.hypot(NOISE_T, share * CURRENT_A * np.abs(winding().field_T(POINTS_M)))
    assert (scale > 1.3 * NOISE_T).any()
    expected = stats.norm.logpdf(ERROR_T, scale=scale).sum()
    effects = {"noise_grows[probe]": {"share": share}}
    assert log_likelihood(measured(), effects) == pytest.approx(expected, rel=1e-7)


def test_jitter_says_how_readings_of_a_mover_that_misses_its_targets_scatter():
    """4000 visits of every position by magpylib; standard deviations are then good to 1.1 % each."""
    sd_m, n = 2e-5, 4000
    random = np.random.default_rng(9)
    visited_m = np.repeat(POINTS_M, n, axis=0) + sd_m * random.normal(size=(n * len(POINTS_M), 3))
    scatter_T = (CURRENT_A * winding().field_T(visited_m)).reshape(len(POINTS_M), n, 3).std(axis=1)
    density = posterior(measured(), {"position_jitter[mapper]": {"sd_m": sd_m}})
    sigma_T = density.component_sigma_T(density.coordinates.start()).numpy().reshape(-1, 3)
    np.testing.assert_allclose(np.sqrt(sigma_T**2 - NOISE_T**2), scatter_T, rtol=0.04, atol=1e-9)


def test_unit_error_scales_the_noise_with_the_field():
    observations = measured()
    factor = 1e3
    recorded = observations.with_field(factor * observations.field_sensor_T)
    expected = stats.norm.logpdf(factor * ERROR_T, scale=factor * NOISE_T).sum()
    effects = {"unit_error[record]": {"field_factor": factor}}
    assert log_likelihood(recorded, effects) == pytest.approx(expected, rel=1e-9)


def test_misstated_noise_is_that_multiple_of_the_stated_one():
    expected = stats.norm.logpdf(ERROR_T, scale=3.0 * NOISE_T).sum()
    effects = {"noise_misstated[probe]": {"factor": 3.0}}
    assert log_likelihood(measured(), effects) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(
    ("noise", "is_asked"),
    [
        ("noise_uT: 5", True),
        ("noise_uT: {prior: {log_normal: {median: 5, relative_sd: 0.05}}}", True),
        ("noise_uT: {prior: {log_normal: {median: 5, relative_sd: 0.5}}}", False),
    ],
)
def test_noise_that_the_rig_file_leaves_open_is_no_cause_beside(noise, is_asked):
    rig = rig_from_text(RIG.replace("noise_uT: 5", noise))
    circumstances = Circumstances(rig, readings(POINTS_M))
    assert EFFECTS["noise_misstated"].concerns(circumstances, "probe") is is_asked
