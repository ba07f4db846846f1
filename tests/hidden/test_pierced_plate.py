"""A map through the opening of an end plate, as of a solenoid in its yoke: readings by magpylib's loops and quadrature, the plate to be found."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from estimator import diagnose, load_rig
from estimator.store.importers.readings_csv import read_readings_csv
from tests.hidden.coil import Winding, blocks_of, circular_field
from tests.hidden.pierced_sheet import pierced_T

COIL = Winding(radius_m=0.1, wire_radius_m=1e-3, axial_loops=20, radial_loops=6)
RIG = """
schema_version: 1
name: map of a solenoid
movers:
  mapper:
    motion: pose
    world_from_base:
      x_mm: {prior: {normal: {mean: 0, sd: 2}}}
      y_mm: {prior: {normal: {mean: 0, sd: 2}}}
      z_mm: {prior: {normal: {mean: 0, sd: 2}}}
coils:
  solenoid:
    radius_mm: {prior: {normal: {mean: 100, sd: 0.5}}}
    wire_radius_mm: {prior: {normal: {mean: 1, sd: 0.005}}}
    axial_loops: 20
    radial_loops: 6
    current_gain: {prior: {normal: {mean: 1, sd: 0.005}}}
sensors:
  probe: {carried_by: mapper, noise_uT: {prior: {log_normal: {median: 2, relative_sd: 0.5}}}}
"""
POSE = ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad")
READINGS, NOISE_T, CURRENT_A = 160, 2e-6, 5.0


@pytest.mark.parametrize("seed", [41])
def test_plate_is_named_and_its_place_and_opening_are_found(tmp_path, seed):
    rng = np.random.default_rng(seed)
    height_m, opening_m = rng.uniform(0.2, 0.26), rng.uniform(0.045, 0.06)
    write_map(tmp_path, height_m, opening_m, rng)
    rig = load_rig(tmp_path / "rig.yaml")
    found = diagnose(read_readings_csv(tmp_path / "readings.csv", rig), seed=seed).record()
    assert found["verdict"] == "named"
    cause = found["causes"][0]
    assert cause["name"] == "pierced_plate"
    for key, truth in {"z_m": height_m, "radius_m": opening_m, "strength": 1.0}.items():
        known = cause["parameters"][key]
        assert abs(known["median"] - truth) < 4.0 * known["sd"] + 0.01 * truth
    assert found["gain"]["after"]["vector_T"] < 1.1 * np.sqrt(3.0) * NOISE_T


def write_map(folder: Path, height_m: float, opening_m: float, rng: np.random.Generator) -> None:
    """A rig file and readings on both sides of the plate, those near it within its opening."""
    at_m = np.zeros((READINGS, 3))
    at_m[:, 2] = rng.uniform(0.06, 0.4, READINGS)
    beside_m, turn = 0.7 * opening_m * np.sqrt(rng.random(READINGS)), rng.uniform(0.0, 2.0 * np.pi, READINGS)
    at_m[:, 0], at_m[:, 1] = beside_m * np.cos(turn), beside_m * np.sin(turn)
    current_A = CURRENT_A * rng.choice([-1.0, 0.5, 1.0], READINGS)
    field_T = current_A[:, None] * pierced_T(circular_field(blocks_of(COIL)), height_m, opening_m, at_m)
    field_T += NOISE_T * rng.standard_normal(field_T.shape)
    (folder / "rig.yaml").write_text(RIG, encoding="utf-8")
    with (folder / "readings.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(
            ["t_s", "sensor", "solenoid_current_A", *(f"mapper_{k}" for k in POSE), "Bx_T", "By_T", "Bz_T"]
        )
        for i in range(READINGS):
            writer.writerow([2.0 * i, "probe", current_A[i], *at_m[i], 0.0, 0.0, 0.0, *field_T[i]])
