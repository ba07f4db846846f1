"""Two coils with iron cores that nobody mentioned: found by name and size, and the field right where nobody measured."""

from __future__ import annotations

import numpy as np
import pytest

from estimator import diagnose, load_rig
from estimator.store.importers.readings_csv import read_readings_csv
from tests.hidden.cored_pair import NAMES, NOISE_T, CoredPair, Iron, write

ACROSS = 4  # cubes


@pytest.mark.slow
@pytest.mark.parametrize("seed", [7])  # the search was tuned on 1
def test_cores_of_both_coils_are_named_and_measured(tmp_path, seed):
    rng = np.random.default_rng(seed)
    iron = Iron()
    write(tmp_path, CoredPair((iron, iron), rng, across=ACROSS), 10, rng)
    rig = load_rig(tmp_path / "rig.yaml")
    found = diagnose(read_readings_csv(tmp_path / "readings.csv", rig), seed=seed).to_json()
    causes = {cause["name"]: cause["parameters"] for cause in found["causes"]}
    assert {f"cross_magnetisation[{name}]" for name in NAMES} <= set(causes)
    assert not any(name.startswith(("neighbour_coil", "current_gain")) for name in causes)
    for name in NAMES:
        known = causes[f"cross_magnetisation[{name}]"]
        edge_m = 2.0 * iron.radius_m / ACROSS  # of a cube: the truth knows its own shape no better
        assert abs(known["length_m"]["median"] - iron.length_m) < edge_m
        limit = known["saturation_T"]
        assert abs(limit["median"] - iron.saturation_T) < 3.0 * limit["sd"]
    gain = found["gain"]
    assert gain["after"]["vector_T"] < 1.2 * np.sqrt(3.0) * NOISE_T
    assert gain["before"]["vector_T"] > 5.0 * gain["after"]["vector_T"]
