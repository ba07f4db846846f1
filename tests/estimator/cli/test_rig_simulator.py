"""`coilcal rig-simulator`: runs as a program of its own, and leaves no process behind however it ends."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from drivers.open import check_device, open_devices
from tests.estimator.cli.conftest import run
from tests.program import PROGRAM, launched

START_S, END_S = 180.0, 20.0


def start(rig: Path, out: Path, *more: str) -> subprocess.Popen[str]:
    """The simulator, once its instruments answer."""
    call = [*PROGRAM, "rig-simulator", str(rig), "--out", str(out), *more]
    program = launched(*call)
    deadline_s = time.monotonic() + START_S
    while not out.exists():
        assert program.poll() is None, program.stderr and program.stderr.read()
        assert time.monotonic() < deadline_s
        time.sleep(0.05)
    return program


def children(pid: int) -> list[int]:
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def all_end(pids: list[int]) -> bool:
    deadline_s = time.monotonic() + END_S
    while time.monotonic() < deadline_s:
        if not any(Path(f"/proc/{pid}").exists() for pid in pids):
            return True
        time.sleep(0.02)
    return False


@pytest.fixture
def rig_path(tmp_path: Path, rig_text: str) -> Path:
    path = tmp_path / "rig.yaml"
    path.write_text(rig_text, encoding="utf-8")
    return path


@pytest.fixture
def program(rig_path: Path) -> Iterator[subprocess.Popen[str]]:
    running = start(rig_path, rig_path.with_name("devices.yaml"))
    yield running
    running.kill()
    running.communicate()


@pytest.mark.parametrize(
    "how",
    [*(pytest.param(how, marks=pytest.mark.slow) for how in (signal.SIGINT, signal.SIGTERM)), signal.SIGKILL],
)
def test_its_instruments_end_with_it(program, rig_path, how):
    simulators = children(program.pid)
    section = yaml.safe_load(rig_path.with_name("devices.yaml").read_text())["devices"]
    assert len(simulators) >= len(section) == 4
    with open_devices(section) as devices:
        for device in devices.devices.values():
            check_device(device)
    os.kill(program.pid, how)
    said = program.communicate(timeout=END_S)
    assert all_end(simulators)
    assert "Traceback" not in said[1]
    assert yaml.safe_load(said[0])["devices"] == section


def test_what_cannot_be_hidden_is_refused_before_anything_runs(rig_path):
    result = run("rig-simulator", rig_path, "--hide", "position_lag[arm1]=1e-3")
    assert result.exit_code == 2
    assert "position_lag[arm1].lag_m depends on where the mover came from" in result.stderr
    result = run("rig-simulator", rig_path, "--hide", "axis_gian=1e-3")
    assert result.exit_code == 2
    assert "the closest is axis_gain" in result.stderr
