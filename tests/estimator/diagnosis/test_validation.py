"""Scores and improvement on unseen readings, against SciPy's densities and against sessions of known truth."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy import stats

from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.validation import Improvement, improvement_of, validation_scores
from estimator.effects.attach import with_effect
from estimator.model.measurement_model import MeasurementModel
from estimator.model.simulate import simulate
from estimator.readings.metrics import error_metrics
from estimator.readings.observations import Observations
from estimator.readings.plan import Plan
from estimator.rig.rig import Cause, Rig
from estimator.store.session import Session
from tests.estimator.diagnosis.small_fits import fit_of, with_wrong

pytestmark = pytest.mark.whole

NOISE_T = 5e-6
GAIN = Cause("axis_gain", "hall")
OFFSET = Cause("sensor_offset", "hall")


@pytest.fixture(scope="module")
def truth_rig(small_rig: Rig, small_truth: dict[str, float]) -> Rig:
    return small_rig.with_values(small_truth)


@pytest.fixture(scope="module")
def wrong_zero(truth_rig: Rig, small_session: Session) -> Observations:
    """The small session with a sensor offset of eight times the noise."""
    return with_wrong(truth_rig, small_session.observations, OFFSET, {"z_T": 60e-6})


@pytest.fixture(scope="module")
def fits(small_rig: Rig, wrong_zero: Observations) -> tuple[Fit, Fit]:
    return fit_of(small_rig, wrong_zero.calibration), fit_of(small_rig, wrong_zero.calibration, OFFSET)


@pytest.fixture(scope="module")
def improvement(fits: tuple[Fit, Fit], wrong_zero: Observations) -> Improvement:
    return improvement_of(*fits, wrong_zero.validation)


def test_log_density_is_that_of_normals_as_wide_as_noise_and_parameters_together(fits, wrong_zero):
    """The spread of the prediction by 4000 draws of the parameters, instead of by its Jacobian."""
    fit, unseen = fits[1], wrong_zero.validation
    scores = validation_scores(fit, unseen)
    draws = torch.from_numpy(
        np.random.default_rng(3).multivariate_normal(fit.vector.numpy(), fit.covariance.numpy(), 4000)
    )
    model = MeasurementModel.unruled(fit.rig, unseen).with_rules(fit.posterior.model.rules)
    with torch.no_grad():
        spread_T = model.predict(fit.posterior.coordinates.values(draws)).std(0).numpy()
        mean_T = model.predict(fit.values).expand(len(unseen), 3).numpy()
    expected = stats.norm.logpdf(unseen.field_sensor_T.numpy(), mean_T, np.hypot(NOISE_T, spread_T)).sum(1)
    assert (spread_T > 0.2 * NOISE_T).any()
    np.testing.assert_allclose(scores.log_density.numpy(), expected, rtol=0.0, atol=0.05)
    assert scores.elpd == pytest.approx(float(scores.log_density.sum()), rel=1e-12)


def test_predictions_scatter_as_draws_do(fits, wrong_zero):
    """Draws of a normal posterior, and such that scatter three times as far."""
    fit, unseen = fits[1], wrong_zero.validation
    draws = torch.from_numpy(
        np.random.default_rng(3).multivariate_normal(fit.vector.numpy(), fit.covariance.numpy(), 4000)
    )
    by_draws, scores = validation_scores(fit, unseen, draws=draws), validation_scores(fit, unseen)
    np.testing.assert_allclose(by_draws.log_density, scores.log_density, rtol=0.0, atol=0.1)
    assert by_draws.predicted_coverage90 == pytest.approx(scores.predicted_coverage90, abs=0.05)
    farther = validation_scores(fit, unseen, draws=fit.vector + 3.0 * (draws - fit.vector))
    widened = validation_scores(fit, unseen, 9.0 * fit.covariance)
    np.testing.assert_allclose(farther.log_density, widened.log_density, rtol=0.0, atol=0.2)
    assert farther.coverage90 >= by_draws.coverage90


def test_errors_are_those_of_the_prediction_at_the_maximum(fits, wrong_zero):
    fit, unseen = fits[1], wrong_zero.validation
    model = MeasurementModel.unruled(fit.rig, unseen).with_rules(fit.posterior.model.rules)
    with torch.no_grad():
        mean_T = model.predict(fit.values).expand(len(unseen), 3)
    expected = error_metrics(unseen.field_sensor_T.numpy(), mean_T.numpy())
    assert validation_scores(fit, unseen).errors.vector_T == pytest.approx(expected.vector_T, rel=1e-5)


def test_errors_are_told_beside_what_noise_leaves_of_the_same_readings(fits, wrong_zero):
    unseen = wrong_zero.validation
    of_one_axis = replace(unseen, field_sensor_T=unseen.field_sensor_T.clone())
    of_one_axis.field_sensor_T[:, 1:] = math.nan
    noise_T, words = validation_scores(fits[1], unseen).of_noise()
    assert (noise_T, words) == (pytest.approx(math.sqrt(3.0) * NOISE_T), "the expected noise leaves")
    assert validation_scores(fits[1], of_one_axis).of_noise()[0] == pytest.approx(NOISE_T)


def test_right_cause_gains_on_unseen_readings(improvement):
    assert improvement.is_significant
    assert improvement.after.errors.vector_T < 0.75 * improvement.before.errors.vector_T
    assert improvement.after.errors.component_T == pytest.approx(NOISE_T, rel=0.4)
    assert improvement.before.coverage90 < improvement.after.coverage90


def test_difference_and_its_error_are_sums_over_readings(improvement):
    by_reading = (improvement.after.log_density - improvement.before.log_density).numpy()
    assert improvement.elpd_difference == pytest.approx(by_reading.sum(), rel=1e-12)
    assert improvement.elpd_difference == pytest.approx(
        improvement.after.elpd - improvement.before.elpd, rel=1e-9
    )
    assert improvement.elpd_se == pytest.approx(
        math.sqrt(len(by_reading)) * by_reading.std(ddof=1), rel=1e-12
    )


def test_few_readings_know_their_own_error_too_little_to_refute(improvement):
    """Two normal differences lie more than three of their standard errors below zero in one case of ten."""
    few = replace(improvement.before, log_density=improvement.before.log_density[:2])
    lost = replace(improvement, elpd_difference=-6.0, elpd_se=1.0)
    assert lost.is_loss
    assert not replace(lost, before=few).is_loss
    assert not replace(lost, before=few, elpd_difference=6.0).is_significant


def test_parameters_that_stood_in_for_the_cause_move_back(improvement, fits, small_truth):
    before, after = fits
    assert set(improvement.moved_sd) == set(small_truth)
    for name, moved in improvement.moved_sd.items():
        expected = float(after.values[name] - before.values[name]) / before.value_sd(name)
        assert moved == pytest.approx(expected, rel=1e-9, abs=1e-12)
    assert max(abs(moved) for moved in improvement.moved_sd.values()) > 2.0


def test_superfluous_cause_gains_nothing(small_rig, small_session):
    seen, unseen = small_session.observations.calibration, small_session.observations.validation
    chance = improvement_of(fit_of(small_rig, seen), fit_of(small_rig, seen, GAIN), unseen)
    assert not chance.is_significant
    assert abs(chance.elpd_difference) < 3.0


@pytest.fixture(scope="module")
def large_session(truth_rig: Rig, small_plan: Plan) -> Observations:
    """The small plan, repeated twenty times."""
    return simulate(truth_rig, replace(small_plan, repeats=20), {}, seed=5)


def test_intervals_of_a_right_model_cover_what_they_say(small_rig, large_session):
    """540 components: 1.3 and 2.2 % are one standard error of 90 and 50 %."""
    scores = validation_scores(fit_of(small_rig, large_session.calibration), large_session.validation)
    assert scores.coverage90 == pytest.approx(0.9, abs=0.04)
    assert scores.coverage50 == pytest.approx(0.5, abs=0.065)


def test_missing_components_do_not_count_and_nothing_becomes_nan_in_json(fits, wrong_zero):
    unseen = wrong_zero.validation
    holes = unseen.field_sensor_T.clone()
    holes[0, 1:], holes[1:, 2] = math.nan, math.nan
    scores = validation_scores(fits[1], unseen.with_field(holes))
    complete = validation_scores(fits[1], unseen)
    assert len(scores.log_density) == len(unseen)
    assert scores.elpd < complete.elpd  # densities in tesla are large: fewer components, less of them
    assert math.isnan(scores.errors.angular_deviation_rad)
    record = scores.to_json()
    assert record["angular_deviation_rad"] is None
    assert all(value is None or math.isfinite(value) for value in record.values())


def test_naming_outliers_gains_on_unseen_readings_that_have_them(small_rig, large_session):
    cause, share, ratio = Cause("outliers", "hall"), 0.05, 20.0
    random = torch.Generator().manual_seed(2)
    is_bad = torch.rand(len(large_session), 3, generator=random) < share
    error_T = ratio * NOISE_T * torch.randn(len(large_session), 3, generator=random, dtype=torch.float64)
    spoilt = large_session.with_field(large_session.field_sensor_T + is_bad * error_T)
    seen = spoilt.calibration
    # Before, the noise is as wide as all errors together; after, the outliers are apart from it.
    wide = fit_of(
        small_rig.with_values({"hall.noise_T": NOISE_T * math.hypot(1.0, math.sqrt(share) * ratio)}), seen
    )
    mixed = with_effect(small_rig, cause, seen, {"share": share, "ratio": ratio})
    narrow = fit_rig(
        mixed, seen, wide.start_with(mixed) | {"hall.noise_T": NOISE_T}, wide.posterior.model.rules
    )
    assert narrow.posterior.log_likelihood(narrow.vector) > wide.posterior.log_likelihood(wide.vector) + 100.0
    assert improvement_of(wide, narrow, spoilt.validation).elpd_difference > 0.0
