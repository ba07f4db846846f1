"""The difference of two gains of a sensor is known where their common part is nearly that of more turns."""

from __future__ import annotations

import math

import pytest
import torch

from estimator.diagnosis.fitting import fit_rig
from estimator.diagnosis.intervals import Intervals
from estimator.effects.attach import with_effect
from estimator.rig.rig import Cause
from tests.estimator.diagnosis.sessions import plain_fit
from tests.estimator.diagnosis.small_fits import fit_of

GAIN, OFFSET = Cause("axis_gain", "hall"), Cause("sensor_offset", "hall")
pytestmark = pytest.mark.whole


def test_gains_of_two_axes_differ_by_what_was_hidden():
    plain = plain_fit((("axis_gain[hall].x", 0.01),))
    fit = fit_of(plain.rig, plain.observations, GAIN)
    found = Intervals(fit).difference(GAIN)
    assert found is not None
    assert found.plus == "x"
    assert found.minus in ("y", "z")
    low, high = found.interval.ci90
    assert low < 0.01 < high
    assert found.interval.sd < 0.5 * fit.value_sd("axis_gain[hall].x")


def test_its_standard_deviation_is_that_of_correlated_numbers():
    plain = plain_fit((("axis_gain[hall].x", 0.01),))
    fit = fit_of(plain.rig, plain.observations, GAIN)
    names = ("axis_gain[hall].x", "axis_gain[hall].z")
    draws = torch.distributions.MultivariateNormal(fit.vector, fit.covariance).sample((4000,))
    values = fit.posterior.coordinates.values(draws)
    scattered = float((values[names[0]] - values[names[1]]).std())
    assert math.isclose(fit.difference_sd(*names), scattered, rel_tol=0.06)  # five Monte Carlo errors


def test_offsets_that_are_known_one_by_one_need_no_difference():
    plain = plain_fit((("sensor_offset[hall].x_T", 60e-6),))
    fit = fit_of(plain.rig, plain.observations, OFFSET)
    assert Intervals(fit).difference(OFFSET) is None


def test_a_cause_of_one_quantity_has_none():
    plain = plain_fit()
    rig = with_effect(plain.rig, Cause("current_offset", "coil1"), plain.observations, {})
    fit = fit_of(rig, plain.observations)
    assert Intervals(fit).difference(Cause("current_offset", "coil1")) is None


@pytest.mark.parametrize("factor", [1.0, 1e-3])
def test_a_number_that_readings_hardly_narrow_is_said_to_be_mostly_its_prior(factor):
    plain = plain_fit()
    rig = with_effect(plain.rig, GAIN, plain.observations, {}, factor=factor)
    told = Intervals(fit_rig(rig, plain.observations, plain.values, plain.posterior.model.rules)).quantities(
        GAIN
    )
    assert [size.is_of_prior for size in told.values()] == [factor < 1.0] * 3
    assert all(size.words.endswith(", mostly its prior") == size.is_of_prior for size in told.values())
