"""A map of two superconducting coils on one bobbin, one powered: what the filaments of the other do is to be found, by its name and size."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from estimator import diagnose, load_rig
from estimator.store.importers.readings_csv import read_readings_csv
from tests.hidden.bore_map import NOISE_T, places_m, write_map
from tests.hidden.coil import Winding, blocks_of, circular_field
from tests.hidden.magnetised_winding import screened_T, trapped_T

POWERED = Winding(radius_m=0.1, wire_radius_m=1e-3, axial_loops=30, radial_loops=6)
IDLE = Winding(radius_m=0.1, wire_radius_m=1e-3, axial_loops=20, radial_loops=8)
APART_M = 0.15  # between front faces
COILS = """
coils:
  powered:
    superconducting: true
    radius_mm: {prior: {normal: {mean: 100, sd: 0.5}}}
    wire_radius_mm: {prior: {normal: {mean: 1, sd: 0.005}}}
    axial_loops: 30
    radial_loops: 6
    current_gain: {prior: {normal: {mean: 1, sd: 0.005}}}
  idle: {superconducting: true, radius_mm: 100, wire_radius_mm: 1, axial_loops: 20, radial_loops: 8, world_from_coil: {z_mm: 150}}
"""
READINGS, CURRENTS_A = 100, (30.0, 30.0, 15.0, -15.0)

NOISE_LIKE_GUIDES = pytest.mark.xfail(
    strict=True,
    reason="errors of the mover's guides have 57 % beside the cause, whose name and sizes are right",
)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [58, pytest.param(57, marks=NOISE_LIKE_GUIDES)])
def test_flux_that_the_idle_coil_holds_and_screens_is_named_and_measured(tmp_path, seed):
    rng = np.random.default_rng(seed)
    truth = {"axial_T": rng.uniform(1e-3, 3e-3), "susceptibility": rng.uniform(0.05, 0.2)}
    write(tmp_path, truth, rng)
    rig = load_rig(tmp_path / "rig.yaml")
    found = diagnose(read_readings_csv(tmp_path / "readings.csv", rig), seed=seed).to_json()
    assert found["verdict"] == "named"
    cause = found["causes"][0]
    assert cause["name"] == "filament_magnetisation[idle]"
    for key, value in truth.items():
        known = cause["parameters"][key]
        assert abs(known["median"] - value) < 4.0 * known["sd"] + 0.02 * value
    assert found["gain"]["after"]["vector_T"] < 1.1 * np.sqrt(3.0) * NOISE_T


def write(folder: Path, truth: dict[str, float], rng: np.random.Generator) -> None:
    """Readings in the bore of both coils."""
    at_m = places_m(READINGS, -0.2, 0.3, 0.045, rng)
    current_A = rng.choice(CURRENTS_A, READINGS)
    coil = circular_field(blocks_of(POWERED))
    shift_m = np.array([0.0, 0.0, APART_M])
    answer = screened_T(IDLE, truth["susceptibility"], lambda p: coil(p + shift_m), at_m - shift_m)
    field_T = current_A[:, None] * (coil(at_m) + answer) + trapped_T(IDLE, truth["axial_T"], at_m - shift_m)
    write_map(folder, COILS, {"powered": current_A, "idle": 0.0 * current_A}, at_m, field_T, rng)
