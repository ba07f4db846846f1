from __future__ import annotations

from itertools import product

import pytest
import torch

from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.structure.residual_tests import lack_of_fit, structure
from estimator.readings.observations import Observations
from estimator.rig_files.read import rig_from_text
from tests.estimator.conftest import RIG
from tests.estimator.diagnosis.sessions import plain_fit
from tests.estimator.diagnosis.small_fits import fit_of, predicted_T

QUIET_T, LOUD_T = 5e-6, 200e-6
TWO_PROBES = RIG.replace(
    "  hall:\n    noise_uT: 5\n",
    "  quiet: {noise_uT: 5}\n  loud: {noise_uT: 200, world_from_sensor: {x_mm: 10}}\n",
)


def with_noise(fit: Fit, seed: int) -> Fit:
    """The fit with the residual of pure noise."""
    generator = torch.Generator().manual_seed(seed)
    noise = torch.randn(len(fit.residual), 1, generator=generator, dtype=torch.float64)
    copy = Fit(fit.posterior, fit.optimum)
    copy.__dict__["residual"] = fit.projector.rest(noise)[:, 0]
    return copy


def test_a_session_without_flaw_shows_no_structure_and_no_lack_of_fit():
    fit = plain_fit()
    assert min(test.p_value for test in structure(fit)) > 0.01
    assert lack_of_fit(fit).p_value > 0.05


@pytest.mark.parametrize(
    ("hidden", "along"),
    [
        ((("offset_drift.x_T_per_h", 2e-3),), "time"),
        ((("cubic_response.z_per_T2", -60.0),), "field in the sensor frame, z"),
        ((("sensor_offset.z_T", 60e-6),), "a constant offset"),
        ((("axis_gain.x", 0.02),), "field in the sensor frame, x"),
    ],
)
def test_the_residual_of_a_cause_has_structure_along_what_the_cause_depends_on(hidden, along):
    tests = structure(plain_fit(hidden))
    by_name = {test.covariate.name: test for test in tests}
    assert by_name[along].p_value < 0.001
    assert by_name[along].share > 3.0 * by_name[along].expected_share
    assert along in [test.covariate.name for test in tests[:2]]


def test_noise_is_taken_from_repeats_where_there_are_any():
    once = plain_fit()
    assert lack_of_fit(once).noise_from == "specification"
    twice = plain_fit(currents_A=(3.0, 3.0, -3.0))
    size = lack_of_fit(twice)
    assert size.noise_from == "repeats"
    assert size.noise_T == pytest.approx(20e-6, rel=0.2)


def test_lack_of_fit_is_seen_against_repeats():
    hidden = (("sensor_offset.z_T", 60e-6),)
    assert lack_of_fit(plain_fit(hidden, (3.0, 3.0, -3.0))).p_value < 1e-6


def two_probes(n_repeats: int) -> Fit:
    """A quiet probe that is read ten times at each place, and one with forty times its noise that is read so many times."""
    rig = rig_from_text(TWO_PROBES)
    place_m = 0.02 * torch.tensor(list(product((-1.0, 0.0, 1.0), repeat=3)), dtype=torch.float64)
    motion = {"arm1": torch.nn.functional.pad(place_m.repeat(10 + n_repeats, 1), (0, 3))}
    sensor = torch.tensor([0] * 270 + [1] * 27 * n_repeats)
    n = len(sensor)
    current_A, field_T = torch.full((n, 1), 3.0, dtype=torch.float64), torch.zeros(n, 3, dtype=torch.float64)
    readings = Observations.of(current_A, motion, field_T, sensor=sensor)
    noise_T = torch.tensor([QUIET_T, LOUD_T], dtype=torch.float64)[sensor][:, None]
    normal = torch.randn(n, 3, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    return fit_of(rig, readings.with_field(predicted_T(rig, readings) + noise_T * normal))


@pytest.mark.parametrize(("n_repeats", "noise_from"), [(1, "specification"), (10, "repeats")])
def test_each_sensor_is_held_against_its_own_noise(n_repeats, noise_from):
    """Repeats of a quiet sensor do not say that a loud one misses; nor does its noise hide what the quiet one does."""
    size = lack_of_fit(fit := two_probes(n_repeats))
    assert size.noise_from == noise_from
    assert size.p_value > 0.01
    wrong = Fit(fit.posterior, fit.optimum)
    wrong.__dict__["residual"] = fit.residual.where(fit.posterior.sensor == 1, 1.5 * fit.residual)
    assert lack_of_fit(wrong).p_value < 1e-4


def test_numbers_that_priors_hold_cost_no_degree_of_freedom(small_rig, small_session):
    """One reading of a rig with as many free numbers as it has components."""
    readings = small_session.observations
    one = readings.rows(torch.tensor([3]))
    fit = fit_rig(small_rig, one, {}, fit_of(small_rig, readings).posterior.model.rules)
    assert fit.jacobian.shape[1] == len(fit.residual)
    assert 0.001 < lack_of_fit(fit).p_value < 1.0


def test_probabilities_do_not_depend_on_the_size_of_the_noise():
    fit = with_noise(plain_fit(), 3)
    louder = Fit(fit.posterior, fit.optimum)
    louder.__dict__["residual"] = 7.0 * fit.residual
    assert [test.p_value for test in structure(louder)] == [test.p_value for test in structure(fit)]


@pytest.mark.slow
def test_structure_is_seen_in_pure_noise_as_often_as_it_says():
    n = 200
    least = torch.tensor(
        [min(test.p_value for test in structure(with_noise(plain_fit(), s))) for s in range(n)]
    )
    for level in (0.05, 0.2, 0.5):
        expected, sd = level, (level * (1.0 - level) / n) ** 0.5
        assert abs(float((least <= level).double().mean()) - expected) < 3.0 * sd


def test_a_probability_over_all_covariates_is_larger_than_each_by_itself():
    for test in structure(with_noise(plain_fit(), 5)):
        assert test.p_value >= min(test.by_component)
