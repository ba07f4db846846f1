"""`coilcal acquire --until` with simulated instruments: ends when the question is answered, goes on after a kill, is shown later."""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from estimator.store.journal import JOURNAL, read_journal
from estimator.store.session import is_growing, load_session
from tests.estimator.cli.conftest import refused, run
from tests.estimator.cli.test_acquire import (
    bring_home,
    call,
    copy_without_devices,
    gone_on,
    is_off,
    quicker,
    running,
)
from tests.estimator.cli.test_rig_simulator import START_S
from tests.program import PROGRAM, ROOT

GOAL = "field 0.5 % in box x_mm=-20:20 y_mm=-20:20 z_mm=-10:10"
UNTIL = ("--until", GOAL, "--longest-settle", "0.5")
PLAN = """\
schema_version: 1
name: places to choose from
settle_s: 0.02
poses:
  calibration:
    arm1: {x_mm: {from: -40, to: 40, count: 3}, y_mm: {from: -40, to: 40, count: 3}, z_mm: {from: -20, to: 20, count: 2}}
currents_A: [{coil1: 3}, {coil1: -3}, {}]
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, rig_text: str) -> Iterator[Path]:
    """Rig, places and the devices of a rig that runs."""
    with running(tmp_path_factory.mktemp("until"), rig_text, PLAN, "--set", "hall.noise_T=2e-5") as path:
        quicker(path)
        yield path


@pytest.mark.flaky(reruns=2)
def test_a_killed_session_goes_on_with_the_same_decisions_until_its_goal(folder, tmp_path):
    bring_home(folder)
    out = tmp_path / "session.zarr"
    program = subprocess.Popen([*PROGRAM, *call(folder, out, *UNTIL)], cwd=ROOT, stderr=subprocess.PIPE)
    deadline_s = time.monotonic() + START_S
    while not (out / JOURNAL).exists() or (out / JOURNAL).read_bytes().count(b"\n") < 4:
        assert program.poll() is None, program.stderr and program.stderr.read()
        assert time.monotonic() < deadline_s
        time.sleep(0.02)
    program.kill()
    program.communicate()
    assert is_growing(out)
    before = read_journal(out)[1]
    result = gone_on(folder, out, *UNTIL)
    assert result.exit_code == 0, result.stderr
    shown = json.loads(result.stdout)
    assert shown["ended"]["reason"].startswith("goal reached, also by")
    header, entries = read_journal(out)
    assert entries[: len(before)] == before
    assert header["goals"] == [GOAL]
    assert shown["stops"] == len(entries) == len(load_session(out).observations)
    assert is_off(folder)
    told = run("show", out)
    assert "goal reached, also by" in told.stdout
    assert "greatest expected gain by second" in told.stdout


@pytest.mark.flaky(reruns=2)
def test_it_ends_at_its_limit_and_does_not_go_on_with_another_goal(folder, tmp_path):
    bring_home(folder)
    out = tmp_path / "session.zarr"
    result = gone_on(folder, out, *UNTIL, "--most-stops", 3)
    assert json.loads(result.stdout)["ended"]["reason"].startswith("limit of 3 stops")
    assert len(json.loads(run("show", out, "--json").stdout)["decisions"]) == 3
    (out / "zarr.json").unlink()  # as if it were interrupted
    other = [word.replace("0.5 %", "0.4 %") for word in call(folder, out, *UNTIL)]
    assert "must go on with the goals" in refused(run(*other))


@pytest.mark.flaky(reruns=2)
def test_a_stop_that_the_arm_refuses_is_skipped_and_told(folder, tmp_path):
    bring_home(folder)
    out, devices, narrow = tmp_path / "session.zarr", folder / "devices.yaml", tmp_path / "narrow.yaml"
    # The joints of the simulated arm are the numbers of its pose; its controller refuses the places on two sides.
    limits = "    joint_low_rad: [-7, -0.03, -7, -7, -7, -7]\n    joint_high_rad: [7, 0.03, 7, 7, 7, 7]\n"
    narrow.write_text(devices.read_text().replace("    arm: ur3e\n", f"    arm: ur3e\n{limits}"))
    result = gone_on(folder, out, *UNTIL, "--most-stops", 8, "--devices", narrow)
    assert result.exit_code == 0, result.stderr
    assert (
        "a stop was refused, another one is chosen: arm.joint_2_rad must be within -0.03 and 0.03"
        in result.stderr
    )
    decisions = [entry["decision"] for entry in read_journal(out)[1]]
    assert len(decisions) == 8
    refused = decisions[-1]["refused"]
    assert refused
    assert not {decision["row"] for decision in decisions} & set(refused)
    assert decisions == sorted(decisions, key=lambda decision: len(decision["refused"]))  # none is forgotten
    assert is_off(folder)


def test_the_dry_run_names_candidates_and_goals(folder, tmp_path):
    dry = run(*call(folder, tmp_path / "s.zarr", *UNTIL, "--dry-run"))
    assert "54 stops to choose from" in dry.stdout
    assert GOAL in dry.stdout


def test_a_goal_out_of_reach_is_refused_before_an_instrument_is_opened(folder, tmp_path):
    copy_without_devices(folder, tmp_path)
    out, beyond = tmp_path / "s.zarr", GOAL.replace("0.5 %", "0.000001 %")
    said = refused(run(*call(tmp_path, out, "--until", beyond)))
    assert "must be within reach of the candidate stops" in said
    assert not out.exists()


def test_neither_plan_nor_goal_is_refused(folder, tmp_path):
    files = (folder / "rig.yaml", "--devices", folder / "devices.yaml", "--out", tmp_path / "s.zarr")
    assert "must be given a PLAN to carry out, or goals with --until" in refused(run("acquire", *files))
