"""A sensor that sits centimetres from where the rig file puts it, which its nominal place in a winding does not hide."""

from __future__ import annotations

from pathlib import Path

import pytest

from estimator.diagnosis.fitting import fit_rig
from estimator.diagnosis.hypotheses import far_elsewhere as module
from estimator.diagnosis.hypotheses.far_elsewhere import far_elsewhere, rules_and_refusal
from estimator.effects import EFFECTS
from estimator.errors import InvalidInput
from estimator.rig.rig import Cause
from estimator.rig_files.read import load_rig
from estimator.store.importers.readings_csv import read_readings_csv
from estimator.store.session import Session
from tests.estimator.diagnosis.small_fits import fit_of

pytestmark = pytest.mark.whole
CASES = Path(__file__).parents[3] / "fixtures/unit_gate_and_frozen"
SENSOR = Cause("sensor_misplaced", "hall")


@pytest.fixture
def holder() -> Session:
    return read_readings_csv(CASES / "holder_50mm.csv", load_rig(CASES / "rig_pose.yaml"))


def test_the_place_of_the_sensor_is_found_from_within_the_winding(holder):
    readings = holder.observations
    rules, refusal = rules_and_refusal(holder.rig, readings)
    assert refusal is not None
    plain = fit_rig(holder.rig, readings, {}, rules)
    best, *others = far_elsewhere(plain, refusal)
    assert best.rig.effects[-1] == SENSOR
    assert float(best.values[f"{SENSOR.label}.z_m"]) == pytest.approx(50e-3, abs=0.5e-3)
    assert float(best.residual.square().mean()) == pytest.approx(1.0, abs=0.4)
    assert all(best.log_evidence > fit.log_evidence + 20.0 for fit in others)


def test_rules_need_no_mistake_of_the_record(holder, monkeypatch):
    monkeypatch.setattr(module, "EFFECTS", {SENSOR.name: EFFECTS[SENSOR.name]})
    rules, refusal = rules_and_refusal(holder.rig, holder.observations)
    assert refusal is not None
    assert set(rules) == {"coil1"}
    monkeypatch.setattr(module, "EFFECTS", {})
    with pytest.raises(InvalidInput, match="outside the winding"):
        rules_and_refusal(holder.rig, holder.observations)


def test_no_body_sits_elsewhere_where_the_rig_is_right(small_rig, small_session):
    assert far_elsewhere(fit_of(small_rig, small_session.observations.calibration), None) == []
