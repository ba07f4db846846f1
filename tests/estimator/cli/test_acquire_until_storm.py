"""`coilcal acquire --until` killed at 30 instants: the same stops as let alone, and no current stays on."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import pytest

from estimator.cli.output import EXIT_DEVICE
from estimator.store.journal import JOURNAL, read_journal
from estimator.store.made import END
from estimator.store.session import load_session
from tests.estimator.cli.conftest import run
from tests.estimator.cli.killed_inside import Instant
from tests.estimator.cli.test_acquire import bring_home, call, is_off
from tests.estimator.cli.test_acquire_until import UNTIL, folder
from tests.program import launched

__all__ = ["folder"]  # the fixture of a rig that runs

OFF_S = 10.0
HELD_OUT = 7  # the first stop that is
BEFORE_STORED = (Instant.DECIDING, Instant.DECIDED, Instant.ARRIVED, Instant.READ, Instant.TORN)
N_RANDOM = 15  # beside 15 chosen ones


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
def test_killed_while_it_decides_and_stores_a_session_takes_the_same_stops(folder, tmp_path):
    session = interrupted(folder, tmp_path, HELD_OUT + 2)
    session.to(Instant.DECIDING, 4)
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
