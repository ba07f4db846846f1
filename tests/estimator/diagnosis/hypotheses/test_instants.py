"""The instant of an event is found between two readings, though causes start on a coarse grid of instants."""

from __future__ import annotations

import pytest

from estimator.diagnosis.hypotheses.candidates import candidates
from estimator.diagnosis.hypotheses.instants import at_finer_instant
from estimator.diagnosis.hypotheses.screening import Screened, screening
from estimator.rig.rig import Cause, Rig
from estimator.store.session import Session
from tests.estimator.diagnosis.small_fits import fit_of, with_wrong

pytestmark = pytest.mark.whole

SIZES = {
    Cause("offset_step", "hall"): {"x_T": 60e-6, "z_T": -40e-6},
    Cause("sensor_bumped", "hall"): {"x_m": 1e-3, "z_m": 1e-3},
    Cause("current_step", "coil1"): {"step": 0.05},
}


@pytest.mark.parametrize("cause", SIZES, ids=lambda cause: cause.name)
def test_instant_is_that_between_the_last_reading_before_and_the_first_after(
    small_rig: Rig, small_truth: dict[str, float], small_session: Session, cause: Cause
):
    readings = small_session.observations.calibration
    hours = (readings.time_s - readings.history.time_s.min()) / 3600.0
    row = 3 * len(readings) // 7  # on none of the coarse instants
    since_h = 0.5 * float(hours[row] + hours[row + 1])
    truth = small_rig.with_values(small_truth)
    fit = fit_of(truth, with_wrong(truth, readings, cause, {**SIZES[cause], "since_h": since_h}))
    coarse = screening(fit, candidates(fit, [cause]))[cause]
    assert coarse.start.shapes["since_h"] != pytest.approx(since_h)
    finer = at_finer_instant(fit, coarse)
    assert float(hours[row]) < finer.start.shapes["since_h"] < float(hours[row + 1])
    assert finer.log_bayes_factor > coarse.log_bayes_factor
    assert finer.highest > coarse.highest


def test_cause_without_an_instant_keeps_its_start(small_rig: Rig, small_session: Session):
    fit = fit_of(small_rig, small_session.observations.calibration)
    (start,) = candidates(fit, [Cause("axis_gain", "hall")])
    screened = Screened(1.5, 2.5, start)
    assert at_finer_instant(fit, screened) == screened
