"""A diagnosis that is stopped reports the best that it has, and goes on with the same command."""

from __future__ import annotations

import json
import os
import signal
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from estimator.diagnosis.fit_journal import FITS
from tests.estimator.cli.conftest import run

pytestmark = pytest.mark.whole
PATIENCE_S = 300.0


@pytest.fixture(scope="module")
def session(workspace: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("flawed") / "session.zarr"
    plan = ["simulate", "--rig", workspace / "rig.yaml", "--plan", workspace / "plan.yaml", "--seed", 1]
    hidden = ["--set", "coil1.axial_loops=13", "--hide", "sensor_offset.x_T=3e-5"]
    assert run(*plan, *hidden, "--out", path).exit_code == 0
    return path


def diagnosed(out: Path) -> dict[str, Any]:
    return json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))


def has_fits(out: Path, n: int) -> bool:
    """Whether so many fits are kept."""
    kept = out.parent.glob(f".{out.name}.*.coilcal/new/{out.name}/{FITS}")
    return any(len(fits.read_bytes().splitlines()) >= n for fits in kept)


def stop_after_a_fit(out: Path) -> None:
    """End this process, which diagnoses, in an orderly way."""
    end_s = time.monotonic() + PATIENCE_S
    while not has_fits(out, 1):
        assert time.monotonic() < end_s
        time.sleep(0.005)
    os.kill(os.getpid(), signal.SIGTERM)


def test_a_stopped_diagnosis_reports_the_best_it_has_and_goes_on(session):
    """That what goes on ends as one that was let alone is asked of the API (test_fit_journal)."""
    out = session.parent / "stopped"
    command = ["diagnose", session, "--out", out, "--seed", 2, "--no-posterior"]
    with ThreadPoolExecutor(1) as beside:
        beside.submit(stop_after_a_fit, out)
        stopped = run(*command)
    assert stopped.exit_code == 0
    assert "the report of the best so far follows" in stopped.stderr
    assert "The diagnosis ended early, for it was stopped; the same command goes on" in stopped.stdout
    assert diagnosed(out)["ended_early"] == "it was stopped"
    assert "The diagnosis ended early" in (out / "report.html").read_text(encoding="utf-8")
    again = run(*command, "--minutes", 1e-9)
    assert again.exit_code == 0
    assert "coilcal: continuing: " in again.stderr  # it does before its first fit
