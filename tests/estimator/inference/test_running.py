"""The running fit is the fit: reading by reading it ends where Levenberg-Marquardt over all readings ends."""

from __future__ import annotations

import math

import pytest
import torch

from estimator.field.winding_shape import DEFAULT_TOLERANCE
from estimator.inference.levenberg_marquardt import levenberg_marquardt
from estimator.inference.likelihood import LogPosterior
from estimator.inference.running import RunningFit
from estimator.model.clearance import nearest_m
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.rig.coordinates import nominal_tensors
from estimator.rig.rig import Rig

pytestmark = pytest.mark.whole


def followed(rig: Rig, observations: Observations, n_each: int) -> RunningFit:
    running = RunningFit(rig)
    for end in range(n_each, len(observations) + 1, n_each):
        running.update(observations.rows(torch.arange(end)).alone, n_each)
    return running


@pytest.mark.parametrize("n_each", [1, 9])
def test_it_ends_within_a_twentieth_of_a_standard_deviation_of_the_fit_of_all(small_session, n_each):
    rig, observations = small_session.rig, small_session.observations.calibration.alone
    running = followed(rig, observations, n_each)
    posterior = LogPosterior(running.coordinates, MeasurementModel.build(rig, observations), observations)
    fit = levenberg_marquardt(posterior, running.coordinates.start()[None])
    sd = running.covariance.diagonal().sqrt()
    assert float(((running.vector - fit.vector[0]) / sd).abs().max()) < 0.05
    assert torch.allclose(
        running.precision, fit.precision[0], rtol=0.02, atol=0.02 * float(fit.precision.max()) ** 0.5
    )
    assert running.n_fits < len(observations) // 2


def test_before_the_first_reading_it_is_the_prior(small_rig):
    running = RunningFit(small_rig)
    width = running.covariance.diagonal().sqrt() / running.coordinates.scale
    assert bool((width > 0.3).all())
    assert bool((width < 3.0).all())


def test_what_is_new_about_readings_is_noise_of_the_size_it_says(small_session):
    observations = small_session.observations.calibration.alone
    running = RunningFit(small_session.rig)
    running.update(observations.rows(torch.arange(7)).alone, 7)
    white = []
    for end in range(8, len(observations) + 1):
        new = running.update(observations.rows(torch.arange(end)).alone, 1)
        [(difference_T, covariance_T2)] = new.one_by_one([torch.arange(len(new.difference_T))])
        factor = torch.linalg.cholesky(covariance_T2)
        white.append(torch.linalg.solve_triangular(factor, difference_T[:, None], upper=False)[:, 0])
    standard = torch.cat(white)
    assert len(standard) == 60
    assert abs(float(standard.mean())) < 0.4
    assert 0.75 < float(standard.std()) < 1.25


def test_a_better_start_is_taken_and_a_worse_one_is_not(small_session):
    observations = small_session.observations.calibration.alone
    running = followed(small_session.rig, observations, 9)
    best = running.vector
    running.refit(observations, running.coordinates.start())
    assert torch.allclose(running.vector, best, rtol=1e-4, atol=1e-6)


def test_rules_are_kept_until_a_sensor_comes_nearer_and_stay_exact(small_session, monkeypatch):
    rig, observations = small_session.rig, small_session.observations.calibration.alone
    chosen = []
    choose = MeasurementModel.choose_rules
    monkeypatch.setattr(
        MeasurementModel, "choose_rules", lambda self, *rest: chosen.append(1) or choose(self, *rest)
    )
    running = RunningFit(rig)
    one_by_one = [observations.rows(torch.tensor([row])).alone for row in range(len(observations))]
    least_m, n_nearer = math.inf, 0
    for reading in one_by_one:
        (distance_m,) = nearest_m(MeasurementModel.unruled(rig, reading)).values()
        n_nearer += distance_m < least_m
        least_m = min(least_m, distance_m)
        kept = running._model(reading).predict(nominal_tensors(rig))
        exact = choose(MeasurementModel.unruled(rig, reading), nominal_tensors(rig), 0.0).predict(
            nominal_tensors(rig)
        )
        assert float((kept - exact).norm() / exact.norm()) < DEFAULT_TOLERANCE
    assert len(chosen) == n_nearer < len(observations)
