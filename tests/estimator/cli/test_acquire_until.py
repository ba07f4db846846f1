"""`coilcal acquire --until` with simulated instruments: ends when the question is answered, and after kills takes the same stops, with no current."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from estimator.cli.output import EXIT_DEVICE
from estimator.store.journal import JOURNAL, read_journal
from estimator.store.made import END
from estimator.store.session import load_session
from tests.estimator.cli.conftest import refused, run
from tests.estimator.cli.killed_inside import Instant
from tests.estimator.cli.test_acquire import (
    bring_home,
    call,
    copy_without_devices,
    gone_on,
    is_off,
    quicker,
    running,
)
from tests.program import launched

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
OFF_S = 10.0
HELD_OUT = 7  # the first stop that is
BEFORE_STORED = (Instant.DECIDING, Instant.DECIDED, Instant.ARRIVED, Instant.READ, Instant.TORN)
N_RANDOM = 15  # beside 15 chosen ones


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, rig_text: str) -> Iterator[Path]:
    """Rig, places and the devices of a rig that runs."""
    with running(tmp_path_factory.mktemp("until"), rig_text, PLAN, "--set", "hall.noise_T=2e-5") as path:
        quicker(path)
        yield path


@pytest.mark.flaky(reruns=2)
def test_it_ends_when_the_question_is_answered_and_is_shown_later(folder, tmp_path):
    bring_home(folder)
    out = tmp_path / "session.zarr"
    result = gone_on(folder, out, *UNTIL)
    assert result.exit_code == 0, result.stderr
    shown = json.loads(result.stdout)
    assert shown["ended"]["reason"].startswith("goal reached, also by")
    header, entries = read_journal(out)
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


@dataclass(frozen=True)
class Interrupted:
    """A measurement that is killed again and again, beside one that was let alone.

    Attributes:
        folder: Rig, places and instruments.
        alone: The session that was let alone.
        out: The other one.
        most_stops: Of each.
    """

    folder: Path
    alone: Path
    out: Path
    most_stops: int

    def to(self, instant: Instant, number: int) -> None:
        """Go on, and be killed at an instant; again where the computer was too busy for an instrument."""
        while (end := _ended(self._program(instant, number)))[0] != -signal.SIGKILL:
            assert end[0] == EXIT_DEVICE, (instant, number, end)
        self.check()

    def some_time(self, n_more: int, later_s: float) -> None:
        """Go on, and be killed from outside some time after so many stops more."""
        running, n_before = self._program(Instant.NEVER, 0), self.n_stored
        while running.poll() is None and self.n_stored < n_before + n_more:
            time.sleep(0.01)
        time.sleep(later_s)
        os.kill(running.pid, signal.SIGKILL)
        _ended(running)
        self.check()

    def to_the_end(self) -> None:
        """Go on without a kill."""
        while (end := _ended(self._program(Instant.NEVER, 0)))[0] != 0:
            assert end[0] == EXIT_DEVICE, end
        assert stops(self.out) == stops(self.alone)
        assert (self.out / END).read_bytes() == (self.alone / END).read_bytes()
        assert len(load_session(self.out).observations) == len(load_session(self.alone).observations)

    def check(self) -> None:
        """No current flows soon after a kill, and what is stored is as in the other session."""
        deadline_s = time.monotonic() + OFF_S
        while not is_off(self.folder):
            assert time.monotonic() < deadline_s
        assert stops(self.out) == stops(self.alone)[: self.n_stored]

    @property
    def n_stored(self) -> int:
        """Number of stops on the disk."""
        return len(stops(self.out))

    def _program(self, instant: Instant, number: int) -> subprocess.Popen[str]:
        arguments = call(self.folder, self.out, *UNTIL, "--most-stops", self.most_stops)
        kill = ["-m", "tests.estimator.cli.killed_inside", instant, str(number), str(self.alone)]
        command = [sys.executable, *kill, *arguments]
        return launched(*command)


def _ended(running: subprocess.Popen[str]) -> tuple[int, str]:
    """Exit code of a measurement, and what it said."""
    _, said = running.communicate()
    assert "Traceback" not in said, said
    return running.returncode, said


def stops(out: Path) -> list[str]:
    """What was decided and measured, stop by stop, without what a clock says."""
    told = ("decision", "is_validation", "repeat", "current_A", "motion", "field_T")
    entries = read_journal(out)[1] if (out / JOURNAL).exists() else []
    return [json.dumps({key: entry[key] for key in told}) for entry in entries]


def interrupted(folder: Path, tmp_path: Path, most_stops: int) -> Interrupted:
    """A session that was let alone, and what is to be compared with it."""
    bring_home(folder)
    alone = tmp_path / "alone.zarr"
    while (end := run(*call(folder, alone, *UNTIL, "--most-stops", most_stops))).exit_code != 0:
        assert end.exit_code == EXIT_DEVICE, end.stderr
    return Interrupted(folder, alone, tmp_path / "killed.zarr", most_stops)


@pytest.mark.flaky(reruns=2)
def test_killed_while_it_stores_and_ends_a_session_takes_the_same_stops(folder, tmp_path):
    session = interrupted(folder, tmp_path, HELD_OUT + 2)
    session.to(Instant.TORN, HELD_OUT)
    session.to(Instant.ENDED, HELD_OUT + 2)
    session.to_the_end()


@pytest.mark.slow
def test_killed_at_30_instants_a_session_takes_the_same_stops(folder, tmp_path):
    session, draw = interrupted(folder, tmp_path, 100), random.Random(58)
    n_stops = len(stops(session.alone))
    first = [(BEFORE_STORED[n % len(BEFORE_STORED)], n) for n in range(HELD_OUT)]
    for instant, number in (*first, *((instant, HELD_OUT) for instant in (*BEFORE_STORED, Instant.STORED))):
        session.to(instant, number)
    for _ in range(N_RANDOM):
        if session.n_stored < n_stops - 4:
            session.some_time(1, 0.3 * draw.random())
        else:  # while it begins
            session.some_time(0, 2.0 * draw.random())
    session.to(Instant.ENDED, n_stops)
    session.to(Instant.SEALING, n_stops)
    session.to_the_end()
