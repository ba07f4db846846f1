"""A first calibration in the Earth's field, of which the rig file says nothing: right, or suspect with the reason. Readings by other code."""

from __future__ import annotations

from pathlib import Path

import pytest

from estimator.calibration.calibrate import calibrate
from estimator.inference.ensemble import SamplerSettings
from estimator.rig_files.read import load_rig
from estimator.store.importers.readings_csv import read_readings_csv
from estimator.store.session import Session

pytestmark = pytest.mark.whole
SETTINGS = SamplerSettings(target_ess=300.0)
CASE = Path(__file__).parents[1] / "fixtures/first_calibration"


@pytest.fixture(scope="module")
def session() -> Session:
    return read_readings_csv(CASE / "readings.csv", load_rig(CASE / "rig.yaml"))


def test_the_room_is_fitted_though_not_mentioned_and_the_loops_are_counted(session):
    summary = calibrate(session, seed=1, settings=SETTINGS).summary()
    assert summary["quality"]["verdict"] == "good"
    top = summary["loop_counts"][0]
    assert (top["axial"], top["radial"]) == (30, 12)
    assert top["probability"] > 0.99
    room, zero = (
        summary["parameters"][f"{label}.z_T"]["median"]
        for label in ("background_field[room]", "sensor_offset[hall]")
    )
    assert room + zero == pytest.approx(-43e-6, abs=3e-6)
    assert summary["fitted_besides"] == ["background_field[room]", "sensor_offset[hall]"]
    assert "background_field[room]" in summary["notes"][0]


def test_as_described_it_is_suspect_and_readings_without_current_say_so(session):
    summary = calibrate(session, seed=1, as_described=True, settings=SETTINGS).summary()
    assert summary["quality"]["verdict"] == "suspect"
    assert "1.7 times what repeated readings scatter by" in summary["quality"]["reasons"][0]
    assert not summary["fitted_besides"]
