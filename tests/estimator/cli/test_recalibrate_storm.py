"""`coilcal recalibrate` killed again and again: the last good calibration stays current, whole and readable, and the end is the same."""

from __future__ import annotations

import json
import logging
import random
import shutil
import subprocess
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from estimator.model.simulate import simulate
from estimator.readings.plan import Plan
from estimator.recalibration.registry import Registry
from estimator.rig.rig import Rig
from estimator.store.session import Session
from tests.program import PROGRAM, ROOT

N_KILLS = 20
logger = logging.getLogger(__name__)
PATIENCE_S = 300.0
COMMITTING_S = 0.1  # from the first file of a new version to the link that points at it, about
PLACES_M = (
    -0.0425,
    -0.0425,
    -0.0405,
    -0.0420,
)  # of the coil: mounted anew before the third visit and before the fourth


@pytest.fixture
def laboratory(
    rig_text: str, small_rig: Rig, small_plan: Plan, small_truth: dict[str, float], tmp_path: Path
) -> Path:
    """A folder with rig, inbox and the registry of the first visit."""
    (tmp_path / "rig.yaml").write_text(rig_text, encoding="utf-8")
    for i, z_m in enumerate(PLACES_M):
        truth = {**small_truth, "coil1.world_from_coil0.z_m": z_m}
        readings = simulate(small_rig, small_plan, truth, seed=i + 1)
        session = Session(small_rig, readings, "simulated", f"2026-0{i + 1}-01T00:00:00+00:00")
        session.save(tmp_path / "inbox" / f"visit{i}.zarr")
        if i == 0:
            assert start(tmp_path, "begun").wait() == 0
    return tmp_path


def start(folder: Path, registry: str) -> subprocess.Popen[bytes]:
    options = ["--rig", folder / "rig.yaml", "--inbox", folder / "inbox", "--registry", folder / registry]
    call = [*PROGRAM, "recalibrate", *map(str, options), "--ess", "200"]
    return subprocess.Popen(call, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def log(registry: Registry) -> list[dict[str, Any]]:
    """Lines without the time at which they were written, and without their checksums, which hold it too."""
    text = (registry.folder / "log.jsonl").read_text(encoding="utf-8")
    lines = [json.loads(line) for line in text.splitlines(keepends=True) if line.endswith("\n")]
    return [{key: one[key] for key in one if key not in ("concluded", "sha256")} for one in lines]


def contents(registry: Registry, version: int) -> dict[str, bytes]:
    """Every file of a version; its provenance says when it was concluded."""
    folder = registry.folder / "versions" / f"{version:04d}"
    files = (path for path in folder.rglob("*") if path.is_file() and path.name != "provenance.json")
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def is_committing_now(versions: Path) -> bool:
    """Whether a version is being written, or was when a kill came."""
    return any(versions.glob(".*.coilcal"))


def killed(folder: Path, registry: str, after_s: float, is_committing: bool) -> bool:
    """Run and kill some time after the start, or after a version began to be written. Whether it had not ended by then."""
    versions = folder / registry / "versions"
    running = start(folder, registry)
    for is_left_over in (True, False):
        while is_committing and is_committing_now(versions) == is_left_over and running.poll() is None:
            time.sleep(0.001)
    with suppress(subprocess.TimeoutExpired):
        assert running.wait(timeout=after_s) == 0
        return False
    running.kill()
    running.wait()
    return True


@pytest.mark.slow
def test_killed_at_20_random_instants_the_last_good_calibration_stays_current(laboratory):
    shutil.copytree(laboratory / "begun", laboratory / "alone", symlinks=True)
    begin_s = time.monotonic()
    assert start(laboratory, "alone").wait() == 0
    whole_s = time.monotonic() - begin_s
    alone = Registry(laboratory / "alone")
    assert [entry["conclusion"] for entry in log(alone)] == ["updated", "unchanged", "updated", "updated"]
    wanted = {version: contents(alone, version) for version in alone.versions}

    draw = random.Random(6)
    n_kills, n_ends, is_ended, met = 0, 0, False, set()
    while n_kills < N_KILLS or not is_ended:
        name = f"killed{n_ends}"
        stormy = Registry(laboratory / name)
        if not stormy.folder.exists():
            shutil.copytree(laboratory / "begun", stormy.folder, symlinks=True)
        before = stormy.current
        # Every other one while a version is committed, which chance would rarely meet; the last run is let alone.
        is_committing = n_kills % 2 == 1
        after_s = draw.random() * (COMMITTING_S if is_committing else whole_s)
        is_ended = not killed(laboratory, name, after_s if n_kills < N_KILLS else PATIENCE_S, is_committing)
        assert stormy.current is not None
        assert before is not None
        assert stormy.current >= before
        stormy.calibration()
        assert contents(stormy, stormy.current) == wanted[stormy.current]
        assert log(stormy) == log(alone)[: len(log(stormy))]
        if is_ended:
            n_ends += 1
            assert log(stormy) == log(alone)
            assert {version: contents(stormy, version) for version in stormy.versions} == wanted
        else:
            n_kills += 1
            met.add((stormy.current, len(log(stormy)), is_committing_now(stormy.folder / "versions")))
        logger.info("kill %d, %d whole runs; the kills met %s", n_kills, n_ends, sorted(met))
    assert len(met) > 2  # in different states
