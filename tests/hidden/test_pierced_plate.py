"""A map through the opening of an end plate, as of a solenoid in its yoke: readings by magpylib's loops and quadrature, the plate to be found."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from estimator import diagnose, load_rig
from estimator.store.importers.readings_csv import read_readings_csv
from tests.hidden.bore_map import NOISE_T, SOLENOID, SOLENOID_TEXT, places_m, write_map
from tests.hidden.coil import blocks_of, circular_field
from tests.hidden.pierced_sheet import pierced_T

READINGS, CURRENT_A = 160, 5.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", [41])
def test_plate_is_named_and_its_place_and_opening_are_found(tmp_path, seed):
    rng = np.random.default_rng(seed)
    height_m, opening_m = rng.uniform(0.2, 0.26), rng.uniform(0.045, 0.06)
    write(tmp_path, height_m, opening_m, rng)
    rig = load_rig(tmp_path / "rig.yaml")
    found = diagnose(read_readings_csv(tmp_path / "readings.csv", rig), seed=seed).to_json()
    cause = found["causes"][0]
    assert cause["name"] == "pierced_plate"
    assert not cause["alternatives"]
    assert not cause["may_be_unknown"]
    for key, truth in {"z_m": height_m, "radius_m": opening_m, "strength": 1.0}.items():
        known = cause["parameters"][key]
        assert abs(known["median"] - truth) < 4.0 * known["sd"] + 0.01 * truth
    assert found["gain"]["after"]["vector_T"] < 1.1 * np.sqrt(3.0) * NOISE_T


def write(folder: Path, height_m: float, opening_m: float, rng: np.random.Generator) -> None:
    """Readings on both sides of the plate, all within its opening's width."""
    at_m = places_m(READINGS, 0.06, 0.4, 0.7 * opening_m, rng)
    current_A = CURRENT_A * rng.choice([-1.0, 0.5, 1.0], READINGS)
    field_T = current_A[:, None] * pierced_T(circular_field(blocks_of(SOLENOID)), height_m, opening_m, at_m)
    write_map(folder, SOLENOID_TEXT, {"solenoid": current_A}, at_m, field_T, rng)
