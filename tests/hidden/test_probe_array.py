"""A solenoid mapped by six probes on arms, some with a wrong zero, some not where the drawing has them: all of them are to be found, no other."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from estimator import diagnose, load_rig
from estimator.store.importers.readings_csv import read_readings_csv
from tests.hidden.bore_map import NOISE_T, POSE, SOLENOID, SOLENOID_TEXT, places_m, write_map
from tests.hidden.coil import blocks_of, circular_field
from tests.hidden.protocols import Array

ARMS_MM = {"p0": (0, 0), "p1": (10, 0), "p2": (0, 20), "p3": (-30, 0), "p4": (0, -40), "p5": (50, 0)}
PLACES, CURRENT_A = 30, 5.0
OFFSET_T, SHIFT_M, TURN_RAD = 50e-6, 0.5e-3, 5e-3  # sizes of each component, drawn normally
ZERO = ("x_T", "y_T", "z_T")
Pose = tuple[Array, Array]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [71])
def test_every_probe_that_is_wrong_is_named_for_what_it_has(tmp_path, seed):
    rng = np.random.default_rng(seed)
    offsets_T = {name: OFFSET_T * rng.standard_normal(3) for name in rng.choice(list(ARMS_MM), 3, False)}
    misplaced = {
        name: (SHIFT_M * rng.standard_normal(3), TURN_RAD * rng.standard_normal(3))
        for name in rng.choice(list(ARMS_MM), 3, False)
    }
    write(tmp_path, offsets_T, misplaced, rng)
    rig = load_rig(tmp_path / "rig.yaml")
    found = diagnose(read_readings_csv(tmp_path / "readings.csv", rig), seed=seed).to_json()
    assert found["verdict"] in ("named", "indistinguishable")  # a small share may as well be another cause's
    causes = {cause["name"]: cause["parameters"] for cause in found["causes"]}
    sizes = {f"sensor_offset[{name}]": dict(zip(ZERO, size, strict=True)) for name, size in offsets_T.items()}
    sizes |= {
        f"sensor_misplaced[{name}]": dict(zip(POSE, np.concatenate(pose), strict=True))
        for name, pose in misplaced.items()
    }
    assert set(causes) == set(sizes)
    for cause, values in sizes.items():
        for key, value in values.items():
            known = causes[cause][key]
            assert abs(known["median"] - value) < 4.0 * known["sd"], (cause, key)
    assert found["gain"]["after"]["vector_T"] < 1.1 * np.sqrt(3.0) * NOISE_T


def write(
    folder: Path, offsets_T: dict[str, Array], misplaced: dict[str, Pose], rng: np.random.Generator
) -> None:
    """All probes at every place and at one of three currents."""
    mapper_m = places_m(PLACES, -0.2, 0.25, 0.01, rng)
    current_A = CURRENT_A * rng.choice([-1.0, 0.5, 1.0], PLACES)
    coil = circular_field(blocks_of(SOLENOID))
    at_m, readings_T, probe = [], [], []
    for name, arm_mm in ARMS_MM.items():
        shift_m, turn_rad = misplaced.get(name, (np.zeros(3), np.zeros(3)))
        sensor_m = mapper_m + np.array([*arm_mm, 0.0]) / 1e3 + shift_m
        field_T = current_A[:, None] * coil(sensor_m) @ Rotation.from_rotvec(turn_rad).as_matrix()
        at_m.append(mapper_m)
        readings_T.append(field_T + offsets_T.get(name, np.zeros(3)))
        probe += [name] * PLACES
    order = np.arange(len(probe)).reshape(len(ARMS_MM), PLACES).T.ravel()  # all probes at a place, then on
    write_map(
        folder,
        SOLENOID_TEXT,
        {"solenoid": np.tile(current_A, len(ARMS_MM))[order]},
        np.concatenate(at_m)[order],
        np.concatenate(readings_T)[order],
        rng,
        [probe[i] for i in order],
        ARMS_MM,
    )
