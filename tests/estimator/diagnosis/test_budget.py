"""The error budget: shares of the squared error on readings that no fit has seen."""

from __future__ import annotations

import pytest
import torch

from estimator.diagnosis import budget as module
from estimator.diagnosis.budget import Budget, budget
from estimator.diagnosis.fitting import Fit
from estimator.effects import EFFECTS
from estimator.effects.attach import with_effect
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.rig.rig import Cause, Rig
from tests.estimator.diagnosis.small_fits import fit_of

pytestmark = pytest.mark.whole

GAIN, OFFSET = Cause("axis_gain", "hall"), Cause("sensor_offset", "hall")
NOISE_T = 5e-6


@pytest.fixture(scope="module")
def made(small_rig: Rig, two_causes: Observations) -> tuple[Fit, Fit, Budget]:
    plain = fit_of(small_rig, two_causes.calibration)
    both = fit_of(small_rig, two_causes.calibration, GAIN, OFFSET)
    found = budget(plain, both, two_causes.validation, seed=1)
    assert found is not None
    return plain, both, found


def square_T2(fit: Fit, unseen: Observations) -> float:
    """Mean squared length of the errors of a fit."""
    with torch.no_grad():
        errors_T = unseen.field_sensor_T - MeasurementModel.build(fit.rig, unseen).predict(fit.values)
    return float(errors_T.square().sum(1).mean())


def test_share_of_each_cause_is_its_mean_over_both_orders(made, small_rig, two_causes):
    plain, both, found = made
    unseen = two_causes.validation
    none, gain, offset, all_of_them = (
        square_T2(fit, unseen)
        for fit in (
            plain,
            fit_of(small_rig, two_causes.calibration, GAIN),
            fit_of(small_rig, two_causes.calibration, OFFSET),
            both,
        )
    )
    misfit = none - 3.0 * NOISE_T**2
    expected = {
        GAIN: 0.5 * (none - gain + offset - all_of_them) / misfit,
        OFFSET: 0.5 * (none - offset + gain - all_of_them) / misfit,
    }
    assert found.misfit_T == pytest.approx(misfit**0.5, rel=1e-3)
    assert found.noise_T == pytest.approx(3.0**0.5 * NOISE_T)
    assert found.n_readings == len(unseen)
    for cause, share in expected.items():
        assert found.causes[cause].value == pytest.approx(share, abs=5e-3)
    last = min(none - gain, offset - all_of_them) + min(none - offset, gain - all_of_them)
    assert found.shared.value == pytest.approx((none - all_of_them - last) / misfit, abs=5e-3)


def test_shares_and_what_is_left_make_the_whole(made):
    found = made[2]
    assert sum(share.value for share in found.causes.values()) + found.left.value == pytest.approx(1.0)
    assert abs(found.left.value) < 0.1
    for share in (*found.causes.values(), found.left):
        low, high = share.ci90
        assert low <= share.value <= high
        assert high - low > 0.0
    record = found.to_json()
    assert [one["name"] for one in record["causes"]] == ["axis_gain", "sensor_offset"]
    assert record["left"]["share"] == found.left.value


def test_where_not_all_orders_are_tried_an_interval_is_as_wide_as_the_orders_differ(
    made, two_causes, monkeypatch
):
    """A map with fifteen causes gave one of them 7 % in one order and 25 % in another, each as if it were known."""
    plain, both, in_all = made
    monkeypatch.setattr(module, "MOST_IN_ALL_ORDERS", 1)  # both orders are tried still
    found = budget(plain, both, two_causes.validation, seed=1)
    assert found is not None
    assert (in_all.has_all_orders, found.has_all_orders) == (True, False)
    for cause, share in found.causes.items():
        assert share.value == pytest.approx(in_all.causes[cause].value)
        low, high = in_all.causes[cause].ci90
        assert share.ci90[0] < low
        assert share.ci90[1] > high


def test_a_cause_that_is_not_there_has_no_share(small_rig, two_causes):
    causes = (GAIN, OFFSET, Cause("current_gain", "coil1"))
    plain, wider = (fit_of(small_rig, two_causes.calibration, *some) for some in ((), causes))
    found = budget(plain, wider, two_causes.validation, seed=1)
    assert found is not None
    assert abs(found.causes[causes[2]].value) < 0.1


def test_there_is_none_where_the_rig_as_described_misses_no_more_than_noise(small_rig, small_session):
    readings = small_session.observations
    plain, wider = (fit_of(small_rig, readings.calibration, *some) for some in ((), (GAIN,)))
    assert budget(plain, wider, readings.validation, seed=1) is None
    assert budget(plain, plain, readings.validation, seed=1) is None
    assert budget(plain, wider, readings.rows(torch.arange(0)), seed=1) is None


def test_noise_is_that_of_the_record(small_rig, small_session):
    """A clean session in millitesla, which the rig knows, has a thousand times the noise, and no misfit."""
    tesla = small_session.observations
    readings = tesla.with_field(1e3 * tesla.field_sensor_T)
    (place,) = EFFECTS["unit_error"].places(small_rig)
    unit = {"field_factor": 1e3, "current_factor": 1.0}
    rig = with_effect(small_rig, Cause("unit_error", place), readings, unit)
    plain, wider = (fit_of(rig, readings.calibration, *some) for some in ((), (GAIN,)))
    assert budget(plain, wider, readings.validation, seed=1) is None
