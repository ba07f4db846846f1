"""The posterior density against SciPy's normal distribution, component by component."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property

import numpy as np
import pytest
import torch
from scipy import stats
from torch.func import jacfwd

from estimator.derivatives import jacobian_of
from estimator.effects.attach import with_effect
from estimator.inference import levenberg_marquardt, likelihood
from estimator.inference.levenberg_marquardt import _gradient_and_precision
from estimator.inference.likelihood import LogPosterior
from estimator.model.measurement_model import MeasurementModel
from estimator.rig.coordinates import Coordinates
from estimator.rig.parameters import Parameter, Tie
from estimator.rig.rig import Cause

TWO_SENSORS = """{near: {noise_uT: 0.3, carried_by: stage}, far: {carried_by: stage, flange_from_sensor: {y_mm: 15},
  noise_uT: {prior: {log_normal: {median: 0.8, relative_sd: 0.5}}}}}"""
COIL = """{coil1: {radius_mm: {prior: {normal: {mean: 50, sd: 2, lower: 45}}}, wire_radius_mm: 1, axial_loops: 3, radial_loops: 2,
  world_from_coil: {z_mm: {prior: {normal: {mean: -40, sd: 2}}}}}}"""


@pytest.fixture(scope="module")
def posterior(problem) -> LogPosterior:
    """Two sensors of different noise, and readings that lack components."""
    simulated = problem(COIL, TWO_SENSORS, noise_T=0.4e-6)
    field = simulated.observations.field_sensor_T.clone()
    field[0, 1] = field[3, 0] = field[3, 2] = torch.nan
    field[5] = torch.nan
    return LogPosterior(
        simulated.real.coordinates, simulated.real.model, simulated.observations.with_field(field)
    )


def prior_draws(posterior: LogPosterior, number: int) -> torch.Tensor:
    draws = posterior.coordinates.sample_prior(np.random.default_rng(1), 4 * number)
    return draws[torch.isfinite(posterior.coordinates.log_prior(draws))][:number]


def test_log_likelihood_is_the_sum_of_scipys_normal_densities_over_what_was_measured(posterior, problem):
    observations = problem(COIL, TWO_SENSORS, noise_T=0.4e-6).observations
    missing = {(0, 1), (3, 0), (3, 2), (5, 0), (5, 1), (5, 2)}
    for vector in prior_draws(posterior, 4):
        values = posterior.coordinates.values(vector)
        predicted = posterior.model.predict(values)
        noise = [values["near.noise_T"].item(), values["far.noise_T"].item()]
        expected = sum(
            stats.norm.logpdf(
                observations.field_sensor_T[i, j].item(),
                predicted[i, j].item(),
                noise[observations.sensor[i]],
            )
            for i in range(len(observations))
            for j in range(3)
            if (i, j) not in missing
        )
        assert posterior.log_likelihood(vector).item() == pytest.approx(expected, rel=1e-12)
    assert len(posterior.measured_T) == 3 * len(observations) - len(missing)
    assert posterior.n_by_sensor.sum() == len(posterior.measured_T)


def test_posterior_is_prior_times_likelihood(posterior):
    vectors = prior_draws(posterior, 6)
    expected = posterior.coordinates.log_prior(vectors) + posterior.log_likelihood(vectors)
    torch.testing.assert_close(posterior(vectors), expected, rtol=1e-14, atol=0.0)


def test_whitened_residuals_of_the_truth_are_standard_normal(problem):
    """The noise of the readings is that of the rig here, but for the first sensor, whose noise is said to be half of it."""
    sensors = TWO_SENSORS.replace("noise_uT: 0.3", "noise_uT: 0.2").replace("median: 0.8", "median: 0.4")
    positions_m = np.random.default_rng(2).uniform(-0.02, 0.02, (300, 3))
    posterior = problem(COIL, sensors, noise_T=0.4e-6, positions_m=positions_m).real
    whitened = posterior.whitened(posterior.coordinates.start())
    assert stats.kstest(whitened[posterior.sensor == 1].numpy(), "norm").pvalue > 0.01
    assert stats.kstest(0.5 * whitened[posterior.sensor == 0].numpy(), "norm").pvalue > 0.01


@pytest.mark.parametrize("noise", [None, Cause("position_jitter", "stage"), Cause("outliers", "far")])
def test_blocks_give_what_all_readings_and_rows_at_once_give(posterior, noise, monkeypatch):
    """Down to one row and a few readings at a time; some readings have no component or lack one."""
    coordinates, model = posterior.coordinates, posterior.model
    observations = model.circumstances.observations
    if noise is not None:
        rig = with_effect(coordinates.rig, noise, observations, {})
        posterior = LogPosterior(Coordinates(rig), MeasurementModel.build(rig, observations), observations)
    vectors = prior_draws(posterior, 5)
    density, first_order = posterior(vectors), posterior.to_first_order(vectors)
    slopes = _gradient_and_precision(posterior, vectors)
    monkeypatch.setattr(likelihood, "COMPONENTS_AT_ONCE", len(posterior.sensor))
    monkeypatch.setattr(likelihood, "DERIVATIVES_IN_A_PASS", 3 * 7 * posterior.coordinates.n_continuous)
    monkeypatch.setattr(levenberg_marquardt, "DERIVATIVES_AT_ONCE", 1)
    torch.testing.assert_close(posterior(vectors), density, rtol=1e-13, atol=0.0)
    for blocked, whole in zip(posterior.to_first_order(vectors), first_order, strict=True):
        torch.testing.assert_close(blocked, whole, rtol=1e-11, atol=1e-13 * float(whole.abs().max()))
    for blocked, whole in zip(_gradient_and_precision(posterior, vectors), slopes, strict=True):
        torch.testing.assert_close(blocked, whole, rtol=1e-10, atol=1e-12 * float(whole.abs().max()))


def test_outside_the_prior_the_density_is_zero_and_the_others_keep_theirs(posterior):
    vectors = prior_draws(posterior, 5)
    expected = posterior(vectors)
    mixed = vectors.clone()
    mixed[[1, 3]] = posterior.coordinates.vector({"coil1.radius_m": 0.0449})
    density = posterior(mixed)
    assert density.isneginf().tolist() == [False, True, False, True, False]
    inside = torch.tensor([0, 2, 4])
    torch.testing.assert_close(density[inside], expected[inside], rtol=1e-12, atol=0.0)
    assert posterior(mixed[1]).isneginf()
    assert posterior(mixed[[1, 3]]).isneginf().all()


@pytest.mark.parametrize("column", range(3))
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e300, -1e300])
def test_impossible_coordinates_have_no_density_instead_of_nan(posterior, column, value):
    vectors = prior_draws(posterior, 2)
    vectors[1, column] = value
    density = posterior(vectors)
    assert torch.isfinite(density[0])
    assert density[1].isneginf()


@pytest.mark.parametrize("kind", ["real", "whole"])
def test_slopes_are_what_differences_say(problem, kind):
    """Of what moves the field and of what does not, of rows at once; whole numbers are not stepped."""
    coil = COIL.replace(
        "axial_loops: 3",
        "current_gain: {prior: {normal: {mean: 1, sd: 0.05}}}, axial_loops: {prior: {normal: {mean: 3, sd: 1, lower: 1}}}",
    )
    posterior = getattr(problem(coil, TWO_SENSORS), kind)
    coordinates = posterior.coordinates
    vectors = coordinates.sample_prior(np.random.default_rng(3), 2)
    _, _, jacobian, log_sigma_jacobian = posterior.to_first_order(vectors)
    assert jacobian.shape[-1] == log_sigma_jacobian.shape[-1] == coordinates.n_continuous
    assert coordinates.n_continuous == coordinates.n - (kind == "whole")
    for column in range(coordinates.n_continuous):
        step = torch.zeros_like(vectors)
        step[:, column] = 1e-5 * coordinates.scale[column]
        two = 2e-5 * coordinates.scale[column]
        difference = (posterior.predicted(vectors + step) - posterior.predicted(vectors - step)) / two
        largest = difference.abs().max().item()
        torch.testing.assert_close(jacobian[..., column], difference, rtol=1e-6, atol=1e-7 * largest)
        ends = [torch.log(posterior.component_sigma_T(v)) for v in (vectors + step, vectors - step)]
        torch.testing.assert_close(
            log_sigma_jacobian[..., column], (ends[0] - ends[1]) / two, rtol=1e-7, atol=1e-7
        )
    torch.testing.assert_close(posterior.jacobian(vectors[1]), jacobian[1], rtol=1e-12, atol=0.0)


def test_what_follows_a_gain_is_differentiated_with_it(problem):
    """A pose that is tied to a gain moves the field, though a gain alone does not."""
    sensors = "{hall: {noise_uT: 1, gain: {prior: {normal: {mean: 1, sd: 0.1}}}, carried_by: stage}}"
    rig = problem(COIL, sensors).rig
    tied = Parameter("coil1.world_from_coil.x_m", "m", 0.0, tie=Tie("hall.gain", 0.01))
    rig = replace(rig, parameters={**rig.parameters, tied.name: tied})
    observations = problem(COIL, sensors).observations
    posterior = LogPosterior(Coordinates(rig), MeasurementModel.build(rig, observations), observations)
    vector = posterior.coordinates.start()
    torch.testing.assert_close(
        posterior.jacobian(vector), jacfwd(posterior.predicted)(vector), rtol=1e-9, atol=1e-12
    )


@pytest.mark.parametrize("cause", ["coil_harmonics", "room_harmonics", "sensor_response"])
def test_derivatives_by_amplitudes_of_corrections_are_those_of_automatic_differentiation(posterior, cause):
    """Predictions are linear in them, beside a response that is not."""
    model = posterior.model
    place = {"coil_harmonics": "coil1", "room_harmonics": "room", "sensor_response": "near"}[cause]
    rig = model.rig
    for each in (Cause("cubic_response", "near"), Cause(cause, place)):
        rig = with_effect(rig, each, model.circumstances.observations, {})
    corrected = LogPosterior(Coordinates(rig), model.with_effects_of(rig), model.circumstances.observations)
    vector = corrected.coordinates.start() + 0.3 * corrected.coordinates.scale
    is_amplitude = [name.startswith(cause) for name in corrected.coordinates.names]
    assert sum(is_amplitude) > 2
    exact = jacobian_of(corrected.predicted, vector)
    found = corrected.to_first_order(vector[None])
    columns = exact.norm(dim=0)
    assert (columns[torch.tensor(is_amplitude)] > 0.0).all()
    columns = columns.clamp(min=1e-300)  # the noise has none
    torch.testing.assert_close(found.jacobian_T[0] / columns, exact / columns, rtol=0.0, atol=1e-7)
    torch.testing.assert_close(
        found.log_sigma_jacobian[0], corrected.log_sigma_jacobian(vector), rtol=0.0, atol=1e-12
    )
    own = torch.tensor(is_amplitude).nonzero().flatten()
    assert torch.equal(corrected.to_first_order(vector[None], own).jacobian_T, found.jacobian_T[..., own])


def computed_in(posterior: LogPosterior) -> set[str]:
    """Names of what a density computes once and keeps, all computed now."""
    names = {name for name, each in vars(LogPosterior).items() if isinstance(each, cached_property)}
    for name in names:
        getattr(posterior, name)
    return names


def test_a_changed_copy_of_a_density_keeps_nothing_that_was_computed_from_the_old_readings(posterior):
    coordinates, model, vector = posterior.coordinates, posterior.model, prior_draws(posterior, 3)
    observations, few = model.circumstances.observations, torch.tensor([0, 1, 4])
    whole = LogPosterior(coordinates, model, observations)
    assert len(computed_in(whole)) > 3
    by_row = whole.with_rows(whole.measured_T + 1e-6 * torch.arange(1.0, 4.0)[:, None])
    assert bool((by_row(vector) != whole(vector)).all())
    torch.testing.assert_close(by_row.for_jacobian(vector), by_row(vector), rtol=1e-9, atol=1e-9)
    part, fresh = whole.part(few), LogPosterior(coordinates, model.part(few), observations.rows(few))
    for density in (part, part.for_jacobian):
        torch.testing.assert_close(density(vector), fresh(vector), rtol=1e-9, atol=1e-9)
    torch.testing.assert_close(part.gradient(vector[0]), fresh.gradient(vector[0]), rtol=1e-9, atol=1e-6)
    both = (density.to_first_order(vector[:1]).jacobian_T for density in (part, fresh))
    torch.testing.assert_close(*both, rtol=1e-9, atol=1e-12)
