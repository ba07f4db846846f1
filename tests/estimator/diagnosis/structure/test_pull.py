"""A number that the readings pull far from its prior is noticed, by as much evidence as fits with wider priors have for them."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.structure.pull import pull_of
from estimator.effects.attach import with_effect
from estimator.rig.parameters import Normal
from estimator.rig.rig import Cause
from estimator.rig_files.read import load_rig
from estimator.store.importers.readings_csv import read_readings_csv
from tests.estimator.diagnosis.sessions import RIG, plain_fit
from tests.estimator.diagnosis.small_fits import fit_of
from tests.hidden.reported import draw_reported

pytestmark = pytest.mark.whole
PLACE, SD_M = "coil1.world_from_coil0.x_m", 1.5e-5  # the readings know it to 0.9e-5


def with_place(off_sd: float, widened: float = 1.0) -> Fit:
    """The plain session, fitted with a place whose stated prior lies so many of its widths from the truth."""
    prior = Normal(float(plain_fit().values[PLACE]) - off_sd * SD_M, widened * SD_M)
    rig = RIG.with_parameters([replace(RIG.parameters[PLACE], prior=prior, value=prior.mean)])
    base = plain_fit()
    return fit_rig(rig, base.observations, base.values, base.posterior.model.rules)


def test_right_priors_leave_nothing():
    assert not pull_of(plain_fit()).is_probable
    assert not pull_of(with_place(1.0)).is_probable


def test_a_number_outside_its_prior_is_told_with_the_number():
    pull = pull_of(with_place(7.0))
    assert pull.is_probable
    assert pull.name == PLACE
    assert pull.widths == pytest.approx(7.0, abs=0.5)  # though the fit has gone only a part of that way


def test_numbers_that_weak_fields_hardly_tell_are_not_pulled(tmp_path):
    """Fields near the noise tell of a product of numbers: along the bend of what they leave open each number lies off a little."""
    draw_reported("recorded_frame", 565_008, 12.0, 12.0).right.write(tmp_path)
    session = read_readings_csv(tmp_path / "readings.csv", load_rig(tmp_path / "rig.yaml"))
    readings = session.observations.calibration
    assert not pull_of(fit_of(session.rig, readings)).is_probable


def test_an_amplitude_of_a_correction_is_no_number_of_the_rig_file():
    """Though it lies farthest of all from the middle of its prior, which is the width that was tried."""
    base, swings = plain_fit(), Cause("room_wanders", "room")
    narrow = {f"degree{i}_{axis}_T": 0.0 for i in (1, 2) for axis in "xyz"}
    rig = with_effect(base.rig, swings, base.observations, {"duration_h": 0.1, **narrow})
    amplitudes = [p for p in rig.free if p.name.startswith(swings.label)]
    rig = rig.with_parameters(replace(p, prior=Normal(1e-3, 1e-9), value=1e-3) for p in amplitudes)
    pull = pull_of(fit_rig(rig, base.observations, base.start_with(rig), base.posterior.model.rules))
    assert pull.name in {p.name for p in base.rig.free}


@pytest.mark.parametrize("wider", [4.0, 16.0])
def test_the_evidence_is_that_of_fits_with_a_wider_prior(monkeypatch, wider):
    monkeypatch.setattr(policy, "WIDER_PRIORS", (wider,))
    stated, wide = with_place(7.0), with_place(7.0, wider)
    by_fits = wide.log_evidence - stated.log_evidence - math.log(wider)
    n_numbers = sum(not parameter.name.endswith("noise_T") for parameter in stated.rig.free)
    by_pull = pull_of(stated).log_bayes_factor + math.log(n_numbers)
    assert by_pull == pytest.approx(by_fits, rel=0.1)
