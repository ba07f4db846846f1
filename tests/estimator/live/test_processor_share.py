"""Work between readings keeps to its share of a core, whatever else the thread does."""

from __future__ import annotations

import pytest

from estimator.live import engine
from estimator.live.engine import MOST_S, SHARE, ProcessorShare


class Clock:
    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_s = self.used_s = 100.0
        monkeypatch.setattr(engine.time, "monotonic", lambda: self.now_s)
        monkeypatch.setattr(engine.time, "thread_time", lambda: self.used_s)

    def work(self, took_s: float) -> None:
        self.now_s += took_s
        self.used_s += took_s

    def sleep(self, took_s: float) -> None:
        self.now_s += took_s


@pytest.mark.parametrize("update_s", [0.0, 0.01, 0.1])
def test_updates_and_polishing_together_keep_to_the_share(monkeypatch, update_s):
    clock = Clock(monkeypatch)
    time_left = ProcessorShare()
    polished_s = 0.0
    for _ in range(200):  # readings, a second apart
        clock.work(update_s)
        end_s = clock.now_s + 1.0 - update_s
        while clock.now_s < end_s:
            if time_left.is_left():
                clock.work(0.004)
                polished_s += 0.004
            else:
                clock.sleep(0.002)
    share = (clock.used_s - 100.0) / (clock.now_s - 100.0)
    assert share == pytest.approx(SHARE, abs=0.002)
    assert polished_s > 0.0


def test_a_pause_saves_up_no_more_than_a_burst_and_a_fast_stream_owes_no_more(monkeypatch):
    clock = Clock(monkeypatch)
    time_left = ProcessorShare()
    clock.sleep(3600.0)
    assert time_left.is_left()
    clock.work(MOST_S / (1.0 - SHARE) + 1e-6)
    assert not time_left.is_left()
    clock.work(60.0)
    assert not time_left.is_left()
    clock.sleep(MOST_S / SHARE + 1e-6)
    assert time_left.is_left()
