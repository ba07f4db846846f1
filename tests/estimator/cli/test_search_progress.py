"""A diagnosis says how far it is: on a terminal in a line that is drawn again, in a pipe by few lines."""

from __future__ import annotations

import io
import sys

from estimator.cli import progress
from estimator.cli.progress import LINE_EVERY_S, Reporter
from estimator.diagnosis.progress import Pace, Progress

SEVENTH = Progress("step 2", 7, 16, 20.3)
WORDS = "step 2: 7 of up to 16 hypotheses fitted, at most about 20 s of fits left"


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_pipe_gets_every_stage_and_progress_only_now_and_then(capsys, monkeypatch):
    now_s = [100.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now_s[0])
    with Reporter(LINE_EVERY_S, LINE_EVERY_S) as reporter:
        reporter.stage("searching for causes")
        for now_s[0] in (110.0, 120.0, 131.0, 140.0, 150.0):
            reporter.fits(SEVENTH)
    assert capsys.readouterr().err.splitlines() == ["coilcal: searching for causes", f"coilcal: {WORDS}"]


def test_a_terminal_shows_progress_at_once_and_names_with_their_places(monkeypatch):
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "150")
    with Reporter(LINE_EVERY_S, LINE_EVERY_S) as reporter:
        reporter.stage("taking axis_gain[hall] (odds 160,000 to 1 for it)")
        reporter.fits(SEVENTH)
    shown = terminal.getvalue()
    assert "coilcal: taking axis_gain[hall] (odds 160,000 to 1 for it)" in shown
    assert WORDS in shown


def test_time_left_is_the_mean_of_the_fits_so_far_for_each_that_may_follow(monkeypatch):
    now_s = [0.0]
    monkeypatch.setattr("estimator.diagnosis.progress.time.monotonic", lambda: now_s[0])
    told: list[Progress] = []
    pace = Pace("step 1", told.append)
    pace.tell(0, 4)
    now_s[0] = 6.0
    pace.tell(3, 5)
    assert told == [Progress("step 1", 0, 4, None), Progress("step 1", 3, 5, 4.0)]
