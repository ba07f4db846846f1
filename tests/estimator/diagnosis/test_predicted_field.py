"""The field that `predict` gives beside what readings show: the same where nothing acts in the readings of one session alone."""

from __future__ import annotations

import pytest
import torch

from estimator.diagnosis.fitting import fit_rig
from estimator.diagnosis.predicted_field import PredictedReadings, not_predicted
from estimator.effects.attach import with_effect
from estimator.effects.use import as_meant
from estimator.rig.rig import Cause
from tests.estimator.diagnosis.small_fits import fit_of

pytestmark = pytest.mark.whole


def test_rows_that_were_written_late_are_put_back_first(small_rig, small_session):
    """A reading late, its field stands beside the pose of another one, in the session and in a prediction of it."""
    readings = small_session.observations.calibration
    rules = fit_of(small_rig, readings).posterior.model.rules
    rig = with_effect(small_rig, Cause("rows_shifted", "record"), readings, {"rows": 1.0})
    fit = fit_rig(rig, readings, {}, rules)
    meant = as_meant(fit.rig, readings)
    read_T = fit.model_of(meant).predict(fit.values).expand(len(meant), 3)
    shown_T = PredictedReadings(fit, readings).shown_T(fit.values)
    is_read = meant.is_measured
    torch.testing.assert_close(shown_T[is_read], read_T[is_read], rtol=1e-4, atol=1e-9)
    assert not_predicted(fit, readings) == ()


def test_leads_that_were_exchanged_in_mid_session_are_in_no_predicted_field(small_rig, small_session):
    """A prediction takes the currents as they are given; nobody knows when they are next recorded the other way round."""
    readings = small_session.observations.calibration.alone
    rules = fit_of(small_rig, readings).posterior.model.rules
    cause = Cause("current_sign_since", "coil1")
    since_h = 0.5 * float(readings.time_s[-1] - readings.time_s[0]) / 3600.0
    rig = with_effect(small_rig, cause, readings, {"sign": -1.0, "since_h": since_h})
    assert not_predicted(fit_rig(rig, readings, {}, rules), readings) == (cause,)
