"""A source that no rig file of ours can tell of: two more windings beside the coil, askew, by magpylib's loops."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from estimator import diagnose, load_rig
from estimator.diagnosis.headline import headline
from estimator.diagnosis.mixture.links import Link
from estimator.effects import EFFECTS
from estimator.store.importers.readings_csv import read_readings_csv
from tests.hidden.bore_map import SOLENOID, SOLENOID_TEXT, places_m, write_map
from tests.hidden.coil import Winding, blocks_of, circular_field
from tests.hidden.protocols import Array

READINGS, CURRENT_A = 70, 5.0
BESIDE = (  # share of the current, external radius (m), turn about x (deg), place (m)
    (-0.4, 0.05, 70.0, (0.14, 0.05, 0.0)),
    (0.3, 0.04, -50.0, (-0.12, 0.1, 0.02)),
)


@pytest.mark.slow
def test_the_field_of_the_coil_is_said_to_be_another_than_any_listed_cause_makes_it(tmp_path):
    write(tmp_path, np.random.default_rng(2))
    rig = load_rig(tmp_path / "rig.yaml")
    session = read_readings_csv(tmp_path / "readings.csv", rig)
    diagnosis = diagnose(session, seed=2)
    record = diagnosis.to_json()
    assert record["verdict"] in ("unexplained", "partly_explained")
    assert record["mixture"]["unlisted"]["winding"] > 0.9
    (found, *_) = [e for e in diagnosis.findings.answer.beside if e.first.link is Link.WINDING]
    assert not found.first.is_listed
    assert any(EFFECTS[found.first.cause.name].words in sentence for sentence in headline(diagnosis))
    assert diagnosis.improvement is not None
    before, after = (
        scores.errors.vector_T for scores in (diagnosis.improvement.before, diagnosis.improvement.after)
    )
    assert after < 0.6 * before


def write(folder: Path, rng: np.random.Generator) -> None:
    """Readings of one probe in the coil's bore and before it."""
    at_m = places_m(READINGS, 0.03, 0.3, 0.05, rng)
    current_A = CURRENT_A * rng.choice([-1.0, 0.5, 1.0], READINGS)
    per_A = circular_field(blocks_of(SOLENOID))(at_m)
    for share, radius_m, turn_deg, place_m in BESIDE:
        per_A += share * winding_askew(radius_m, turn_deg, np.array(place_m), at_m)
    write_map(folder, SOLENOID_TEXT, {"solenoid": current_A}, at_m, current_A[:, None] * per_A, rng)


def winding_askew(radius_m: float, turn_deg: float, place_m: Array, points_m: Array) -> Array:
    """Field per ampere of a winding like the solenoid's that stands beside it, turned about the x axis."""
    turn = Rotation.from_euler("x", turn_deg, degrees=True).as_matrix()
    winding = Winding(radius_m, SOLENOID.wire_radius_m, SOLENOID.axial_loops, SOLENOID.radial_loops)
    return circular_field(blocks_of(winding))((points_m - place_m) @ turn) @ turn.T
