"""Three stops, and a session that is measured at them."""

from __future__ import annotations

from pathlib import Path

import pytest

from estimator.acquisition.pace import stops_of
from estimator.readings.observations import Observations
from estimator.readings.plan import load_plan
from estimator.rig.rig import Rig
from tests.estimator.acquisition.measured import PLAN, Run


@pytest.fixture
def stops(small_rig: Rig, tmp_path: Path) -> Observations:
    path = tmp_path / "plan.yaml"
    path.write_text(PLAN, encoding="utf-8")
    return stops_of(load_plan(path, small_rig), small_rig, seed=0)


@pytest.fixture
def run(tmp_path: Path, small_rig: Rig, stops: Observations) -> Run:
    return Run(tmp_path / "session.zarr", small_rig, stops)
