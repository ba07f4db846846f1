"""Fits that wild readings do not pull: with new fits, and with the slopes that a fit has."""

from __future__ import annotations

import pytest
import torch

from estimator.diagnosis.robust_fit import robust_fit, robust_values
from tests.estimator.diagnosis.small_fits import fit_of

pytestmark = pytest.mark.whole


@pytest.fixture
def right_and_spoilt(small_rig, small_session):
    """Fits to readings, and to the same of which a tenth are reversed."""
    readings = small_session.observations.calibration
    field_T = readings.field_sensor_T.clone()
    field_T[3::10] *= -1.0
    return fit_of(small_rig, readings), fit_of(small_rig, readings.with_field(field_T))


def off_sd(values, fit):
    """Distances of values from those of a fit, in its standard deviations; without the noise, which wild readings widen."""
    names = [name for name in fit.posterior.coordinates.names if not name.endswith("noise_T")]
    return torch.tensor([abs(float(values[name] - fit.values[name])) / fit.value_sd(name) for name in names])


def test_both_find_the_values_of_the_right_readings(right_and_spoilt):
    right, spoilt = right_and_spoilt
    assert off_sd(spoilt.values, right).max() > 10.0
    by_fits = robust_fit(spoilt, spoilt.values, spoilt.observations)
    assert len(by_fits.observations) == len(spoilt.observations) - len(range(3, len(spoilt.observations), 10))
    assert off_sd(by_fits.values, right).max() < 1.5  # a tenth of the readings is missing
    assert off_sd(robust_values(spoilt), right).max() < 1.5


def test_right_readings_hardly_move_them(right_and_spoilt):
    right, _ = right_and_spoilt
    assert off_sd(robust_values(right), right).max() < 0.1


def test_too_few_near_ones_leave_the_fit_as_it_is(right_and_spoilt, monkeypatch):
    _, spoilt = right_and_spoilt
    monkeypatch.setattr("estimator.diagnosis.policy.FAR_FROM_EXPECTED", 1e-9)
    assert robust_values(spoilt) is spoilt.values
