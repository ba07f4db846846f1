"""Fields that were recorded in the axes of the base: a case of a user, whose numbers come from other code."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from estimator.diagnosis.diagnose import diagnose
from estimator.rig_files.read import load_rig
from estimator.store.importers.checked import checked
from estimator.store.importers.readings_csv import read_readings_csv
from estimator.store.session import Session

pytestmark = pytest.mark.whole
CASES = Path(__file__).parents[1] / "fixtures/unit_gate_and_frozen"


def imported(case: str) -> Session:
    session = read_readings_csv(CASES / f"{case}.csv", load_rig(CASES / "rig_pose.yaml"))
    readings = checked(session.rig, session.observations, session.source)
    return replace(session, observations=readings.observations)


def test_fields_in_the_axes_of_the_base_are_named():
    diagnosis = diagnose(imported("base_frame"), seed=1)
    (mistake,) = diagnosis.record_mistakes
    assert mistake.cause.label == "field_frame[hall]"
    gain = diagnosis.to_json()["gain"]
    assert gain["after"]["vector_T"] < 30e-6
    assert gain["before"]["vector_T"] > 500e-6


@pytest.mark.parametrize("holder_mm", [20, 50])
def test_a_sensor_elsewhere_on_its_holder_is_no_mistake_of_the_record(holder_mm):
    """At 50 mm the nominal place of the sensor is in the winding at three poses."""
    diagnosis = diagnose(imported(f"holder_{holder_mm}mm"), seed=1)
    assert not diagnosis.record_mistakes
    assert [cause.cause.name for cause in diagnosis.causes] == ["sensor_misplaced"]
    size_m = float(diagnosis.fits.final.values["sensor_misplaced[hall].z_m"])
    assert size_m == pytest.approx(1e-3 * holder_mm, abs=1e-3)
