"""A screw that moves with the probe is found by name, size and place, in a session that independent code has made."""

from __future__ import annotations

import numpy as np
import pytest

from estimator import diagnose, load_rig
from estimator.store.importers.readings_csv import read_readings_csv
from tests.hidden.pulled_pair import NOISE_T, PulledPair, write
from tests.hidden.screwed_probe import ScrewedProbe


@pytest.mark.parametrize("seed", [12])  # seeds 1 to 3 were looked at before
def test_a_screw_beside_the_probe_is_named_with_its_place(tmp_path, seed):
    rng = np.random.default_rng(seed)
    place_m, radius_m = np.array([0.012, -0.007, 0.009]), 3e-3
    write(tmp_path, ScrewedProbe(PulledPair((0.0, 0.0), rng), place_m, radius_m), 20, rng)
    session = read_readings_csv(tmp_path / "readings.csv", load_rig(tmp_path / "rig.yaml"))
    found = diagnose(session, seed=seed, has_corrections=False).to_json()
    assert found["verdict"] == "named"
    (cause,) = found["causes"]
    assert cause["name"] == "iron_on_sensor"
    told = cause["parameters"]
    for key, truth in zip(("x_m", "y_m", "z_m", "radius_cubed_m3"), (*place_m, radius_m**3), strict=True):
        assert abs(told[key]["median"] - truth) < 4.0 * told[key]["sd"]
    assert found["gain"]["after"]["vector_T"] < 1.1 * np.sqrt(3.0) * NOISE_T
