"""Work that lasts says how much is done; short work says nothing."""

from __future__ import annotations

import io
import sys

import pytest

from estimator.cli import progress
from estimator.cli.progress import COUNTED_EVERY_S, UNTOLD_S, Reporter
from estimator.diagnosis.next_readings.stops import CHOOSING


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture
def now_s(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    now = [100.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    return now


def test_a_pipe_hears_nothing_of_two_seconds_and_then_little(
    now_s: list[float], capsys: pytest.CaptureFixture[str]
) -> None:
    with Reporter(COUNTED_EVERY_S, UNTOLD_S, UNTOLD_S) as reporter:
        for n in range(9):
            now_s[0] = 100.0 + 1.5 * n
            reporter.count("predicting points", 10 * n, 100)
    assert capsys.readouterr().err.splitlines() == [
        "coilcal: predicting points: 20 of 100, about 12 s left",
    ]


def test_a_terminal_shows_a_bar_after_two_seconds(
    now_s: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "150")
    with Reporter(COUNTED_EVERY_S, UNTOLD_S, UNTOLD_S) as reporter:
        reporter.count(CHOOSING, 1, 20)
        assert reporter.bar is not None
        assert not reporter.bar.tasks[0].visible
        now_s[0] += 3.0
        reporter.count(CHOOSING, 2, 20)
    assert "choosing stops: 2 of 20" in terminal.getvalue()
