"""Sensors that only a mistake of the record puts inside a winding: the mistake is named, and nothing else gets past the refusal."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
import torch

from estimator import Session, load_plan, simulate
from estimator.diagnosis.diagnose import diagnose
from estimator.diagnosis.verdict import Verdict
from estimator.errors import InvalidInput
from estimator.model.measurement_model import MeasurementModel
from estimator.rig.rig import Cause, Rig

# Recorded 48 mm towards the sensor and 48 mm aside, the winding would be about it. Turned by 90 degrees the coil stays 20 mm away.
PLAN = """
schema_version: 1
name: flat in other axes
poses:
  calibration:
    arm1: {x_mm: {from: -48, to: 48, count: 5}, y_mm: {from: -20, to: 20, count: 3}, z_mm: {from: -48, to: 48, count: 5}}
currents_A: [{coil1: 3}]
"""
INSIDE = r"sensors must lie outside the winding of coil1; at the rig's nominal values \d+ of \d+ poses do not"


@pytest.fixture(scope="module")
def turned(small_rig: Rig, tmp_path_factory: pytest.TempPathFactory) -> Session:
    path: Path = tmp_path_factory.mktemp("plan") / "plan.yaml"
    path.write_text(PLAN, encoding="utf-8")
    hidden = {
        "displacement_frame.rx_rad": 0.5 * math.pi,
        "displacement_frame.ry_rad": 0.0,
        "displacement_frame.rz_rad": 0.0,
    }
    readings = simulate(small_rig, load_plan(path, small_rig), {}, 1, hidden)
    return Session(small_rig, readings, "simulated")


def test_wrong_frame_that_puts_sensors_inside_the_winding_is_named(turned, small_rig):
    with pytest.raises(InvalidInput, match=INSIDE):
        MeasurementModel.build(small_rig, turned.observations)
    diagnosis = diagnose(turned, seed=1, has_corrections=False)
    (mistake,) = diagnosis.findings.record_mistakes
    assert mistake.cause == Cause("displacement_frame", "arm1")
    assert diagnosis.verdict is Verdict.NAMED
    fitted = diagnosis.fits.final
    turn_rad = [float(fitted.values[f"{mistake.cause.label}.{axis}_rad"]) for axis in ("rx", "ry", "rz")]
    assert turn_rad == pytest.approx([0.5 * math.pi, 0.0, 0.0], abs=0.01)
    improvement = diagnosis.fits.improvement
    assert improvement is not None
    assert (
        improvement.after.errors.vector_T < 2.0 * math.sqrt(3.0) * 5e-6 < improvement.before.errors.vector_T
    )


def test_readings_that_no_mistake_explains_are_refused_in_the_same_words(turned):
    generator = torch.Generator().manual_seed(1)
    noise_T = 5e-6 * torch.randn(len(turned.observations), 3, dtype=torch.float64, generator=generator)
    nothing_there = turned.observations.with_field(noise_T)
    with pytest.raises(InvalidInput, match=INSIDE):
        diagnose(Session(turned.rig, nothing_there, "simulated"), seed=1)
