"""The instant of an event is found between two readings, though causes start on a coarse grid of instants."""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import SimpleNamespace
from typing import cast
from unittest.mock import MagicMock

import pytest
import torch

from estimator.calibration.result import Calibration
from estimator.diagnosis.findings import Fits
from estimator.diagnosis.fitting import fit_rig
from estimator.diagnosis.hypotheses.candidates import candidates
from estimator.diagnosis.hypotheses.instants import best_instants, on_known_sides
from estimator.diagnosis.mixture.listed import _at_finer_instants, _weighed, starts_of
from estimator.diagnosis.outlying import outliers_of
from estimator.diagnosis.posterior import judged_as_handed_out
from estimator.diagnosis.result import Diagnosis
from estimator.diagnosis.validation import improvement_of
from estimator.effects.attach import with_effect
from estimator.model.measurement_model import MeasurementModel
from estimator.rig.rig import Cause
from tests.estimator.diagnosis.mixture.weighed import weighed
from tests.estimator.diagnosis.small_fits import fit_of, with_wrong

pytestmark = pytest.mark.whole

SIZES = {
    Cause("offset_step", "hall"): {"x_T": 60e-6, "z_T": -40e-6},
    Cause("sensor_bumped", "hall"): {"x_m": 2e-3, "z_m": 2e-3},
    Cause("current_step", "coil1"): {"step": 0.05},
}


def test_starts_that_change_the_readings_alike_are_one():
    starts = [{"sign": sign, "since_h": instant_h} for sign in (1.0, -1.0, 2.0) for instant_h in (0.1, 0.2)]
    values = [5.0, 7.0, 7.0 + 1e-9, 6.0, 3.0, 4.0]
    assert best_instants(values, starts) == [(7.0, starts[1]), (4.0, starts[5])]


@pytest.mark.parametrize("cause", SIZES, ids=lambda cause: cause.name)
def test_instant_is_that_between_the_last_reading_before_and_the_first_after(
    small_rig, small_truth, small_session, cause
):
    readings = small_session.observations.calibration
    hours = (readings.time_s - readings.history.time_s.min()) / 3600.0
    row = 3 * len(readings) // 7  # on none of the coarse instants
    since_h = 0.5 * float(hours[row] + hours[row + 1])
    truth = small_rig.with_values(small_truth)
    fit = fit_of(truth, with_wrong(truth, readings, cause, {**SIZES[cause], "since_h": since_h}))
    coarse_h = [candidate.shapes["since_h"] for candidate in candidates(fit, [cause])]
    assert not [at_h for at_h in coarse_h if float(hours[row]) < at_h < float(hours[row + 1])]
    _, item = weighed(fit, [cause])[cause]
    assert float(hours[row]) < item.start["since_h"] < float(hours[row + 1])


def test_a_cause_at_finer_instants_is_together_as_probable_before_as_at_one(small_rig, small_session):
    """It would gain by the number of its instants else."""
    fit = fit_of(small_rig, small_session.observations.calibration)
    (start, *_) = starts_of(fit, candidates(fit, [Cause("offset_step", "hall")]))
    finer = _at_finer_instants(fit, _weighed(fit, [start])[start.candidate.cause][0])
    assert len(finer) > 1
    assert sum(math.exp(each.log_prior) for each in finer) == pytest.approx(math.exp(start.log_prior))
    (gain,) = starts_of(fit, candidates(fit, [Cause("axis_gain", "hall")]))
    assert _at_finer_instants(fit, _weighed(fit, [gain])[gain.candidate.cause][0]) == []


def test_a_spell_is_found_between_the_readings_at_which_it_begins_and_ends(
    small_rig, small_truth, small_session
):
    readings = small_session.observations.calibration
    hours = (readings.time_s - readings.history.time_s.min()) / 3600.0
    first, last = 2 * len(readings) // 7, 4 * len(readings) // 7  # after which it begins and ends
    since_h, until_h = (0.5 * float(hours[row] + hours[row + 1]) for row in (first, last))
    truth, cause = small_rig.with_values(small_truth), Cause("offset_spell", "hall")
    size = {"x_T": 60e-6, "z_T": -40e-6, "since_h": since_h, "until_h": until_h}
    fit = fit_of(truth, with_wrong(truth, readings, cause, size))
    _, item = weighed(fit, [cause])[cause]
    assert item.start == pytest.approx({"since_h": since_h, "until_h": until_h})


@dataclass
class Judged:
    """What `judged_as_handed_out` reads of a diagnosis."""

    fits: Fits


def test_unseen_readings_over_which_an_instant_is_open_are_on_no_known_side(
    small_rig, small_truth, small_session
):
    """Where a block is kept out about the instant, the fitted readings beside it are all that says when it was.

    They judge neither a fit nor the posterior that is drawn beside it, and none of them is an outlier.
    """
    whole = small_session.observations.calibration
    whole = whole.rows(torch.argsort(whole.time_s))
    n, cause = len(whole), Cause("offset_step", "hall")
    hours = (whole.time_s - whole.history.time_s.min()) / 3600.0
    middle, end = n // 2, n - n // 8
    is_block = (torch.arange(n) > middle - 4) & (torch.arange(n) < middle + 4)
    is_late = torch.arange(n) >= end
    truth = small_rig.with_values(small_truth)
    size = {"x_T": 200e-6, "z_T": -200e-6, "since_h": float(hours[middle])}
    wrong = with_wrong(truth, whole, cause, size)
    fitted, unseen = wrong.rows(~(is_block | is_late)), wrong.rows(is_block | is_late)
    rig = with_effect(truth, cause, fitted, {"since_h": float(hours[middle])})
    fit = fit_rig(rig, fitted, rig.nominal_values(), MeasurementModel.build(truth, fitted).rules)
    told = on_known_sides(fit, unseen)
    assert told.time_s.tolist() == wrong.rows(is_late).time_s.tolist()
    later = with_effect(truth, cause, fitted, {"since_h": float(hours[middle + 3])})
    as_probable = fit_rig(later, fitted, later.nominal_values(), fit.posterior.model.rules)
    assert outliers_of(as_probable, wrong, leaves_something=False) == []
    without = fit_rig(truth, fitted, {}, fit.posterior.model.rules)
    assert len(on_known_sides(without, unseen)) == len(unseen)
    improvement = improvement_of(without, fit, told)
    drawn = {
        name: torch.normal(float(fit.values[name]), fit.value_sd(name), (2, 50))
        for name in fit.posterior.coordinates.names
    }
    best = {name: float(value) for name, value in fit.values.items()}
    posterior = SimpleNamespace(
        best=best, draws={name: draws.double().numpy() for name, draws in drawn.items()}
    )
    fits = Fits(fit, fit, fit, MagicMock(), MagicMock(), improvement, None, None)
    judged = judged_as_handed_out(cast(Diagnosis, Judged(fits)), cast(Calibration, posterior), unseen)
    assert judged.fits.improvement is not None
    assert len(judged.fits.improvement.after.log_density) == len(told)
