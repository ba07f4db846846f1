"""coilcal and the hidden generator mean the same by poses, frames, currents and names, where nothing is hidden."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from estimator.model.measurement_model import MeasurementModel
from estimator.rig_files.read import load_rig
from estimator.store.importers.readings_csv import read_readings_csv
from tests.hidden.flaw import record
from tests.hidden.handed_in import HiddenSession
from tests.hidden.open_session import draw_open_session
from tests.hidden.protocols import MOTIONS, PROTOCOLS
from tests.hidden.session import draw_session

TOLERANCE = 1e-8  # of the largest field; the two codes round mu0 differently in its tenth digit


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("cause", [None, "mount_tilt"])
def test_coilcal_predicts_the_generators_readings_from_its_truth(protocol, cause, tmp_path):
    compare(draw_session(7, cause, protocol=protocol), tmp_path)


@pytest.mark.parametrize("motion", MOTIONS)
def test_they_agree_on_every_way_in_which_an_arm_writes_down_where_it_is(motion, tmp_path):
    sessions = (draw_open_session([5], None, 0.0, seed) for seed in range(60))
    hidden = next(h for h in sessions if h.rig is not None and h.rig.motion == motion)
    assert (hidden.schedule.turn is None) == (motion == "displacement")
    compare(hidden, tmp_path)


@pytest.mark.parametrize("name", ["coil_misplaced", "base_misplaced"])
def test_a_wrong_pose_is_that_of_the_rig_file(name, tmp_path):
    hidden = draw_open_session([5], lambda possible: [name] if "base_misplaced" in possible else [], 20.0, 1)
    (flaw,) = hidden.flaws
    moved, _ = flaw.cause.apply(hidden.scene, flaw.size, np.random.default_rng(flaw.seed))
    np.testing.assert_array_equal(record(hidden.scene, [flaw]).field_T, record(moved, []).field_T)
    compare(replace(hidden, scene=moved, flaws=(), visible=(), record=hidden.unflawed), tmp_path)


def compare(hidden: HiddenSession, tmp_path: Path) -> None:
    """coilcal's prediction from the truth beside the generator's readings."""
    hidden.write(tmp_path)
    rig = load_rig(tmp_path / "rig.yaml")
    session = read_readings_csv(tmp_path / "readings.csv", rig)
    values = {name: float(value) for name, value in hidden.truth()["values"].items()}
    for truth in hidden.record.truths:
        values |= {f"coil1.flange_from_coil.{p.name}": float(p.value) for p in truth.parameters}
    rig = rig.with_values(values)
    model = MeasurementModel.build(rig, session.observations, 1e-9)
    nominal = {name: torch.tensor(value, dtype=torch.float64) for name, value in rig.nominal_values().items()}
    perfect_T = record(hidden.scene, hidden.flaws).field_T
    np.testing.assert_allclose(
        model.predict(nominal).numpy(), perfect_T, rtol=0.0, atol=TOLERANCE * np.abs(perfect_T).max()
    )
    assert session.observations.is_validation.tolist() == hidden.schedule.is_validation.tolist()
