"""Two coils whose brackets give way to each other's pull: found by name and softness, in a session that independent code has made."""

from __future__ import annotations

import numpy as np
import pytest

from estimator import diagnose, load_rig
from estimator.store.importers.readings_csv import read_readings_csv
from tests.hidden.pulled_pair import NAMES, NOISE_T, PulledPair, write


@pytest.mark.parametrize("seed", [11])  # seeds 1 to 3 were looked at before
@pytest.mark.slow  # as test_screwed_probe, of the same scene
def test_soft_brackets_are_named_and_measured(tmp_path, seed):
    rng = np.random.default_rng(seed)
    softness = (4e-4, 2.5e-4)
    write(tmp_path, PulledPair(softness, rng), 20, rng)
    rig = load_rig(tmp_path / "rig.yaml")
    session = read_readings_csv(tmp_path / "readings.csv", rig)
    found = diagnose(session, seed=seed, has_corrections=False).to_json()
    assert found["verdict"] == "named"
    causes = {cause["name"]: cause["parameters"] for cause in found["causes"]}
    assert set(causes) == {f"coil_pulled[{name}]" for name in NAMES}
    for name, truth in zip(NAMES, softness, strict=True):
        told = causes[f"coil_pulled[{name}]"]["compliance_m_per_N"]
        # The force is known to the accuracy of a mean loop.
        assert abs(told["median"] - truth) < 4.0 * told["sd"] + 0.03 * truth
    assert found["gain"]["after"]["vector_T"] < 1.1 * np.sqrt(3.0) * NOISE_T
