"""Errors of placement that the readings of a mark share are told as that, with their size, and blame no sensor."""

from __future__ import annotations

import numpy as np
import pytest

from estimator import diagnose, load_rig
from estimator.store.importers.readings_csv import read_readings_csv
from tests.hidden.far_plate import COIL
from tests.hidden.hand_placed import FIRST_M, LAST_M, Hand, write_hand_placed

pytestmark = pytest.mark.whole

SCATTER_M = 0.8e-3


@pytest.fixture(scope="module")
def diagnosis(tmp_path_factory):
    folder, rng = tmp_path_factory.mktemp("hand_placed"), np.random.default_rng(61)
    marks_m = np.round(rng.uniform(FIRST_M, LAST_M, size=(27, 3)), 3)
    write_hand_placed(folder, Hand(marks_m, (1.0, 2.0, -2.0), SCATTER_M), rng)
    session = read_readings_csv(folder / "readings.csv", load_rig(folder / "rig.yaml"))
    return diagnose(session, seed=1, has_posterior=True)


def test_the_stops_are_off_and_nothing_else_is_named(diagnosis):
    [entry] = diagnosis.findings.answer.beside
    assert entry.first.cause.name == "stop_errors"
    assert not diagnosis.causes


def test_the_size_is_that_of_the_hand(diagnosis):
    rig = diagnosis.fits.final.rig
    [width_m] = {p.prior.sd for p in rig.free if p.name.startswith("stop_errors[stage].")}
    assert 0.7 * SCATTER_M < width_m < 1.3 * SCATTER_M


def test_the_coil_is_the_true_one(diagnosis):
    draws = diagnosis.posterior.draws["coil1.radius_m"]
    low, high = np.quantile(draws, [0.01, 0.99])
    assert low < COIL["radius_m"] < high
