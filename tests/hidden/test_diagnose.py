"""Effects hidden by independent code must be found; the diagnosis sees the rig file and the readings only.

A handful for every run; `make hidden` is the study with the confusion matrix.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from estimator import diagnose, load_rig
from estimator.store.importers.readings_csv import read_readings_csv
from tests.hidden.session import draw_session
from tests.hidden.study import credible_sets


def verdict(folder: Path, seed: int, cause: str | None, sigma: float, protocol: str) -> dict[str, Any]:
    """What the diagnosis says of a session with something hidden."""
    draw_session(seed, cause, sigma, protocol).write(folder)
    session = read_readings_csv(folder / "readings.csv", load_rig(folder / "rig.yaml"))
    return diagnose(session, seed=seed).to_json()


@pytest.mark.parametrize(
    ("cause", "seed", "protocol"),
    [
        ("axis_gain", 301, "paper"),
        pytest.param("coil_heating", 303, "recommended", marks=pytest.mark.slow),
        pytest.param("axes_swapped", 305, "paper", marks=pytest.mark.slow),
    ],
)
def test_hidden_cause_is_named(tmp_path, cause, seed, protocol):
    found = verdict(tmp_path, seed, cause, 8.0, protocol)
    assert found["verdict"] in ("named", "indistinguishable")
    assert [names[0] for names in credible_sets({"causes": found["causes"]})] == [cause]
    assert all(one["probability"] > one["p_not_in_library"] for one in found["causes"])
    assert found["elpd_difference"] > 0.0


def test_clean_session_raises_no_alarm_and_names_what_would_have_shown(tmp_path):
    found = verdict(tmp_path, 312, None, 8.0, "recommended")
    assert (found["verdict"], found["causes"]) == ("nothing_found", [])
    assert 0.0 < found["smallest_visible"]["axis_gain[hall].x"]["size"] < 0.02


def test_cause_outside_the_library_is_unexplained_and_not_misnamed(tmp_path):
    found = verdict(tmp_path, 313, "eddy_lag", 12.0, "paper")
    assert found["verdict"] == "unexplained"
    assert found["causes"] == []
    assert found["p_not_in_library"] > 0.8
