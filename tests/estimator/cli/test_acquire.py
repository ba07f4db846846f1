"""`coilcal acquire` with simulated instruments behind real ports: measure, interrupt, go on, and find what was hidden."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import yaml
from click.testing import Result

from drivers.open import open_devices
from drivers.protocols import FlangePose
from estimator.rig_files.read import load_rig
from estimator.store.growing import new_header
from estimator.store.journal import JOURNAL, Journal
from estimator.store.session import is_growing, load_session
from tests.estimator.cli.conftest import run
from tests.estimator.cli.test_rig_simulator import START_S, start
from tests.program import PROGRAM, launched

HIDDEN_XY = 0.04
BUSY = "arm1 failed: "  # by its watchdog, where a busy computer does not kick it five times a second; the same command goes on
NOISE = "noise_uT: {prior: {log_normal: {median: 2, relative_sd: 0.7}}}"
PLAN = """\
schema_version: 1
name: small grid
settle_s: 0.02
poses:
  calibration:
    arm1: {x_mm: {from: -40, to: 40, count: 3}, y_mm: {from: -40, to: 40, count: 2}, z_mm: {from: -20, to: 20, count: 2}}
currents_A: [{coil1: 3}, {coil1: -3}]
"""


@contextmanager
def running(path: Path, rig_text: str, plan: str, *hidden: str) -> Iterator[Path]:
    """A folder with rig, plan and the devices of a rig that runs."""
    (path / "rig.yaml").write_text(rig_text.replace("noise_uT: 5", NOISE), encoding="utf-8")
    (path / "plan.yaml").write_text(plan, encoding="utf-8")
    simulator = start(path / "rig.yaml", path / "devices.yaml", *hidden, "--seed", "1")
    try:
        yield path
        ended = simulator.poll()
    finally:
        simulator.terminate()
        said = simulator.communicate()
    assert ended is None, said[1]


def quicker(path: Path) -> None:
    """Let currents change five times as fast as the simulator's own limits."""
    devices = (path / "devices.yaml").read_text()
    (path / "devices.yaml").write_text(devices.replace("slew_A_per_s: 20", "slew_A_per_s: 100"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, rig_text: str) -> Iterator[Path]:
    """A rig that runs, whose sensor shows part of y in x."""
    hidden = ("--hide", f"cross_axis[hall].xy={HIDDEN_XY}", "--set", "hall.noise_T=5e-6")
    with running(tmp_path_factory.mktemp("acquire"), rig_text, PLAN, *hidden) as path:
        quicker(path)
        yield path


def call(folder: Path, out: Path, *more: object) -> list[str]:
    """The arguments of a measurement."""
    files = [folder / "rig.yaml", folder / "plan.yaml", "--devices", folder / "devices.yaml", "--out", out]
    return [str(argument) for argument in ("acquire", *files, *more)]


def started(folder: Path, out: Path, n_stops: int) -> subprocess.Popen[str]:
    """A measurement that has visited some stops."""
    bring_home(folder)
    deadline_s = time.monotonic() + START_S
    program = begin(folder, out)
    while not (out / JOURNAL).exists() or (out / JOURNAL).read_bytes().count(b"\n") <= n_stops:
        if program.poll() is not None:
            _, said = program.communicate()
            assert BUSY in said, said
            program = begin(folder, out)
        assert time.monotonic() < deadline_s
        time.sleep(0.02)
    return program


def begin(folder: Path, out: Path) -> subprocess.Popen[str]:
    command = [*PROGRAM, *call(folder, out)]
    return launched(*command)


def bring_home(folder: Path) -> None:
    """To where displacements are zero: an interrupted measurement leaves the arm where it stopped."""
    section = yaml.safe_load((folder / "devices.yaml").read_text())["devices"]["arm1"]
    ends_mm = zip(section["workspace_low_mm"], section["workspace_high_mm"], strict=True)
    x_m, y_m, z_m = (5e-4 * (low_mm + high_mm) for low_mm, high_mm in ends_mm)
    with open_devices({"arm1": section}) as devices:
        devices.arms["arm1"].move_to(
            FlangePose((x_m, y_m, z_m), (0.0, 0.0, 0.0)), speed_m_per_s=0.2, timeout_s=10.0
        )


def gone_on(folder: Path, out: Path, *more: object) -> Result:
    """The same command again, and again where the computer was too busy for the arm."""
    for _ in range(4):
        result = run(*call(folder, out, "--json", *more))
        if BUSY not in result.stderr:
            break
    return result


def is_off(folder: Path) -> bool:
    """Whether no current flows."""
    section = yaml.safe_load((folder / "devices.yaml").read_text())["devices"]
    with open_devices({name: section[name] for name in ("coil1", "warmth")}) as devices:
        return abs(devices.sources["coil1"].read_current_A(timeout_s=2.0).value) < 1e-3


def copy_without_devices(folder: Path, to: Path) -> None:
    """The files of a rig none of whose ports is there."""
    text = (folder / "devices.yaml").read_text()
    (to / "devices.yaml").write_text(text.replace("/dev/pts/", "/dev/none/"), encoding="utf-8")
    for name in ("rig.yaml", "plan.yaml"):
        (to / name).write_text((folder / name).read_text(), encoding="utf-8")


def test_the_plan_and_its_times_are_shown_without_touching_anything(folder, tmp_path):
    copy_without_devices(folder, tmp_path)
    out = tmp_path / "session.zarr"
    result = run(*call(tmp_path, out, "--dry-run"))
    assert result.exit_code == 0, result.stderr
    assert "24 stops (0 for validation), 10 readings each, about " in result.stdout
    shown = json.loads(run(*call(tmp_path, out, "--dry-run", "--json")).stdout)
    assert len(shown["stops"]) == 24
    assert shown["stops"][1]["begin_s"] > shown["stops"][0]["begin_s"] == 0.0
    assert not out.exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            ("{coil1: 3}", "{coil1: 7}"),
            "stop 1 of the plan, coil1: coil.current_A must be within -5 and 5; received 7",
        ),
        (("to: 40, count: 3}", "to: 400, count: 3}"), "of the plan, arm1: arm.target.x_m must be within"),
    ],
)
def test_a_plan_beyond_the_limits_is_refused_before_anything_moves(folder, tmp_path, change, message):
    plan = tmp_path / "plan.yaml"
    plan.write_text(PLAN.replace(*change), encoding="utf-8")
    out = tmp_path / "session.zarr"
    arguments = call(folder, out)
    result = run(*[str(plan) if argument.endswith("plan.yaml") else argument for argument in arguments])
    assert result.exit_code == 2
    assert message in result.stderr
    assert not out.exists()
    assert is_off(folder)


def test_a_session_that_is_being_measured_is_not_begun_anew_and_its_instruments_are_not_opened(
    folder, tmp_path
):
    copy_without_devices(folder, tmp_path)
    out = tmp_path / "session.zarr"
    header = new_header(load_rig(folder / "rig.yaml"), "a test", "plan", {})
    with Journal.create(out, header):
        for more in ((), ("--overwrite",)):
            result = run(*call(tmp_path, out, *more))
            assert result.exit_code == 2
            assert "must be written by one process at a time" in result.stderr
    assert is_growing(out)


@pytest.mark.parametrize(
    ("how", "code"),
    [
        *(
            pytest.param(*each, marks=pytest.mark.slow)
            for each in ((signal.SIGINT, 130), (signal.SIGTERM, 143))
        ),
        (signal.SIGKILL, -9),
    ],
)
def test_an_interrupted_run_leaves_no_current_and_goes_on_with_its_own_plan_only(folder, tmp_path, how, code):
    out = tmp_path / "session.zarr"
    program = started(folder, out, 2)
    os.kill(program.pid, how)
    said = program.communicate(timeout=20.0)
    assert program.returncode == code
    assert "Traceback" not in said[1]
    deadline_s = time.monotonic() + 5.0
    while not is_off(folder):
        assert time.monotonic() < deadline_s
    assert is_growing(out)
    assert 2 <= len(load_session(out).observations) < 24
    plan = tmp_path / "plan.yaml"
    plan.write_text(PLAN.replace("{coil1: 3}", "{coil1: 2}"), encoding="utf-8")
    result = run(*[str(plan) if a.endswith("plan.yaml") else a for a in call(folder, out)])
    assert result.exit_code == 2
    assert "must go on with the plan and seed that it began with" in result.stderr
