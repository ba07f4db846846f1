"""Polished between readings, the running estimate is the maximum of the batch fit; unpolished it is not."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from estimator.effects.attach import with_effect
from estimator.inference import running as running_fit
from estimator.inference.levenberg_marquardt import (
    gradient_and_information,
    levenberg_marquardt,
    prior_gradient_and_precision,
)
from estimator.inference.likelihood import LogPosterior
from estimator.inference.positive_definite import inverse
from estimator.inference.running import MOST_SWEEPS, RunningFit
from estimator.model.measurement_model import MeasurementModel
from estimator.model.simulate import simulate
from estimator.readings.observations import Observations
from estimator.readings.plan import Plan
from estimator.rig.parameters import LogNormal, Uniform
from estimator.rig.rig import Cause, Rig

pytestmark = pytest.mark.whole

N, N_BEFORE = 50, 44
EQUAL_SD = 1e-6
WILD_T = 1e-4
FEW_SWEEPS = 7  # without secants it takes up to 15 where noise grows


def batch_maximum(rig: Rig, observations: Observations) -> tuple[Tensor, Tensor]:
    """Maximum of the posterior and its standard deviations: Levenberg-Marquardt from the nominal values, then Newton's method.

    Levenberg-Marquardt alone ends 1e-5 standard deviations away, where no double shows that the density still rises. Gradients are those
    of the exact Jacobian, and the Hessian is their difference.
    """
    model = MeasurementModel.build(rig, observations)
    coordinates = RunningFit(rig).coordinates
    posterior = LogPosterior(coordinates, model, observations)
    fit = levenberg_marquardt(posterior, coordinates.start()[None])
    sd = inverse(fit.precision[0]).diagonal().sqrt()

    def gradient(vectors: Tensor) -> Tensor:
        data, _ = gradient_and_information(posterior, vectors, posterior.to_first_order(vectors))
        return data + prior_gradient_and_precision(coordinates, vectors)[0]

    vector = fit.vector[0]
    for _ in range(5):
        around = vector + 1e-3 * torch.cat((torch.diag(sd), -torch.diag(sd)))
        up, down = gradient(around).split(len(sd))
        hessian = (up - down) / (2e-3 * sd[:, None])
        vector = vector - torch.linalg.solve(0.5 * (hessian + hessian.mT), gradient(vector[None])[0])
    return vector, sd


def polished(running: RunningFit, observations: Observations) -> None:
    while running.can_polish:
        running.polish(observations)


def distance_sd(running: RunningFit, rig: Rig, observations: Observations) -> float:
    """Largest over the coordinates, in standard deviations of the posterior."""
    maximum, sd = batch_maximum(rig, observations)
    return float(((running.vector - maximum) / sd).abs().max())


def first(observations: Observations, n: int) -> Observations:
    return observations.rows(torch.arange(n)).alone


@pytest.fixture
def readings(small_rig: Rig, small_plan: Plan, small_truth: dict[str, float]) -> Observations:
    all_of_them = simulate(small_rig, replace(small_plan, repeats=2), small_truth, seed=150003).calibration
    return first(all_of_them, N)


def with_free_noise(rig: Rig) -> Rig:
    noise = rig.parameters["hall.noise_T"]
    return rig.with_parameters([replace(noise, prior=LogNormal(5e-6, 0.5))])


@pytest.mark.parametrize(
    ("causes", "is_noise_free"),
    [
        pytest.param((), False, marks=pytest.mark.slow),
        ((), True),
        pytest.param(("axis_gain",), True, marks=pytest.mark.slow),
        pytest.param(("outliers",), True, marks=pytest.mark.slow),
        (("noise_grows",), True),
    ],
)
def test_after_each_reading_it_is_the_batch_fit_once_polished_and_not_before(
    small_rig, readings, causes, is_noise_free
):
    rig = with_free_noise(small_rig) if is_noise_free else small_rig
    for cause in causes:
        values = {"share": 0.05, "ratio": 15.0} if cause == "outliers" else {}
        rig = with_effect(rig, Cause(cause, "hall"), readings, values)
    if "outliers" in causes:
        wild_T = torch.zeros_like(readings.field_sensor_T)
        wild_T[::9, 0] = WILD_T
        readings = readings.with_field(readings.field_sensor_T + wild_T)
    running = RunningFit(rig)
    running.update(first(readings, N_BEFORE), N_BEFORE)
    before_sd = []
    for n in range(N_BEFORE + 1, N + 1):
        running.update(first(readings, n), 1)
        assert not running.is_polished
        before_sd.append(distance_sd(running, rig, first(readings, n)))
        n_sweeps = running.n_sweeps
        polished(running, first(readings, n))
        assert running.is_polished
        assert running.n_sweeps - n_sweeps <= FEW_SWEEPS
        assert distance_sd(running, rig, first(readings, n)) < EQUAL_SD
    assert min(before_sd) > EQUAL_SD
    assert max(before_sd) < 0.1


def test_readings_that_come_between_two_parts_do_not_wait_and_are_in_the_result(
    small_rig, readings, monkeypatch
):
    monkeypatch.setattr(running_fit, "GRADIENT_READINGS", 9)
    monkeypatch.setattr(running_fit, "LINEARISED_PREDICTIONS", 50)
    sizes = []
    gradient = LogPosterior.gradient
    monkeypatch.setattr(
        LogPosterior,
        "gradient",
        lambda self, point: sizes.append(len(self.model.circumstances)) or gradient(self, point),
    )
    running = RunningFit(small_rig)
    running.update(first(readings, N_BEFORE), N_BEFORE)
    for n in range(N_BEFORE + 1, N + 1):
        running.update(first(readings, n), 1)
        for _ in range(4):
            running.polish(first(readings, n))
            assert not running.is_polished
            assert distance_sd(running, small_rig, first(readings, n)) < 0.05
    n_sweeps = running.n_sweeps
    assert n_sweeps > 1  # they went on in spite of new readings
    polished(running, readings)
    assert running.n_sweeps > n_sweeps
    assert max(sizes) == 9
    assert distance_sd(running, small_rig, readings) < EQUAL_SD


def test_information_is_that_of_the_place_where_the_maximum_is(small_rig, readings):
    rig = with_free_noise(small_rig)
    running = RunningFit(rig)
    for n in range(3, N + 1):
        running.update(first(readings, n), 1 if n > 3 else 3)
        polished(running, first(readings, n))
    fit = levenberg_marquardt(
        LogPosterior(running.coordinates, MeasurementModel.build(rig, readings), readings),
        running.coordinates.start()[None],
    )
    sd, batch_sd = (inverse(each).diagonal().sqrt() for each in (running.precision, fit.precision[0]))
    # That of the noise depends on how it scattered in the batch fit, on what is expected in the running one.
    assert torch.allclose(sd, batch_sd, rtol=0.05)


def test_at_a_bound_of_the_prior_it_gives_up_and_says_so(small_rig, readings):
    radius = small_rig.parameters["coil1.radius_m"]
    rig = small_rig.with_parameters([replace(radius, prior=Uniform(0.0505, 0.0515))])  # it is 0.0518
    running = RunningFit(rig)
    running.update(readings, N)
    polished(running, readings)
    assert not running.is_polished
    assert running.n_sweeps <= MOST_SWEEPS
