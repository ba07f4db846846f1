"""A map of two superconducting coils on one bobbin, one powered: what the filaments of the other do is to be found, by its name and size."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from estimator import diagnose, load_rig
from estimator.store.importers.readings_csv import read_readings_csv
from tests.hidden.coil import Winding, blocks_of, circular_field
from tests.hidden.magnetised_winding import screened_T, trapped_T

POWERED = Winding(radius_m=0.1, wire_radius_m=1e-3, axial_loops=30, radial_loops=6)
IDLE = Winding(radius_m=0.1, wire_radius_m=1e-3, axial_loops=20, radial_loops=8)
APART_M = 0.15  # between front faces
RIG = """
schema_version: 1
name: two coils of one cryostat
movers:
  mapper:
    motion: pose
    world_from_base:
      x_mm: {prior: {normal: {mean: 0, sd: 2}}}
      y_mm: {prior: {normal: {mean: 0, sd: 2}}}
      z_mm: {prior: {normal: {mean: 0, sd: 2}}}
coils:
  powered:
    superconducting: true
    radius_mm: {prior: {normal: {mean: 100, sd: 0.5}}}
    wire_radius_mm: {prior: {normal: {mean: 1, sd: 0.005}}}
    axial_loops: 30
    radial_loops: 6
    current_gain: {prior: {normal: {mean: 1, sd: 0.005}}}
  idle: {superconducting: true, radius_mm: 100, wire_radius_mm: 1, axial_loops: 20, radial_loops: 8, world_from_coil: {z_mm: 150}}
sensors:
  probe: {carried_by: mapper, noise_uT: {prior: {log_normal: {median: 2, relative_sd: 0.5}}}}
"""
POSE = ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad")
READINGS, NOISE_T, CURRENTS_A = 100, 2e-6, (30.0, 30.0, 15.0, -15.0)


@pytest.mark.parametrize("seed", [57])
def test_flux_that_the_idle_coil_holds_and_screens_is_named_and_measured(tmp_path, seed):
    rng = np.random.default_rng(seed)
    truth = {"axial_T": rng.uniform(1e-3, 3e-3), "susceptibility": rng.uniform(0.05, 0.2)}
    write_map(tmp_path, truth, rng)
    rig = load_rig(tmp_path / "rig.yaml")
    found = diagnose(read_readings_csv(tmp_path / "readings.csv", rig), seed=seed).record()
    assert found["verdict"] == "named"
    cause = found["causes"][0]
    assert cause["name"] == "filament_magnetisation[idle]"
    for key, value in truth.items():
        known = cause["parameters"][key]
        assert abs(known["median"] - value) < 4.0 * known["sd"] + 0.02 * value
    assert found["gain"]["after"]["vector_T"] < 1.1 * np.sqrt(3.0) * NOISE_T


def write_map(folder: Path, truth: dict[str, float], rng: np.random.Generator) -> None:
    """A rig file and readings in the bore of both coils."""
    at_m = np.zeros((READINGS, 3))
    at_m[:, 2] = rng.uniform(-0.2, 0.3, READINGS)
    beside_m, turn = 0.045 * np.sqrt(rng.random(READINGS)), rng.uniform(0.0, 2.0 * np.pi, READINGS)
    at_m[:, 0], at_m[:, 1] = beside_m * np.cos(turn), beside_m * np.sin(turn)
    current_A = rng.choice(CURRENTS_A, READINGS)
    coil = circular_field(blocks_of(POWERED))
    shift_m = np.array([0.0, 0.0, APART_M])
    answer = screened_T(IDLE, truth["susceptibility"], lambda p: coil(p + shift_m), at_m - shift_m)
    field_T = current_A[:, None] * (coil(at_m) + answer) + trapped_T(IDLE, truth["axial_T"], at_m - shift_m)
    field_T += NOISE_T * rng.standard_normal(field_T.shape)
    (folder / "rig.yaml").write_text(RIG, encoding="utf-8")
    with (folder / "readings.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(
            [
                "t_s",
                "sensor",
                "powered_current_A",
                "idle_current_A",
                *(f"mapper_{k}" for k in POSE),
                "Bx_T",
                "By_T",
                "Bz_T",
            ]
        )
        for i in range(READINGS):
            writer.writerow([2.0 * i, "probe", current_A[i], 0.0, *at_m[i], 0.0, 0.0, 0.0, *field_T[i]])
