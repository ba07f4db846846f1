"""coilcal and the hidden generator mean the same by poses, frames, currents and names, where nothing is hidden."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from estimator.model.measurement_model import MeasurementModel
from estimator.rig_files.read import load_rig
from estimator.store.importers.readings_csv import read_readings_csv
from tests.hidden.flaw import record
from tests.hidden.protocols import PROTOCOLS
from tests.hidden.session import draw_session

TOLERANCE = 1e-8  # of the largest field; the two codes round mu0 differently in its tenth digit


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("cause", [None, "mount_tilt"])
def test_coilcal_predicts_the_generators_readings_from_its_truth(
    protocol: str, cause: str | None, tmp_path: Path
) -> None:
    hidden = draw_session(7, cause, protocol=protocol)
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
