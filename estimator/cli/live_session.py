"""A session that `coilcal live` follows, with its posterior and diagnosis in the background: as a state, as JSON and as text."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from estimator.cli.live_view import LiveState, gaps_in
from estimator.live.engine import LiveEngine, Step
from estimator.reporting.numbers import displays, with_sd
from estimator.store.made import JOURNAL

if TYPE_CHECKING:
    from estimator.live.refresh import Background, Refreshed

POLL_S = 0.002  # a look takes a hundredth of it


def wait_for(path: Path, wait_s: float) -> None:
    """Wait until `coilcal acquire` begins a session, at most so long."""
    journal = path / JOURNAL
    deadline_s = time.monotonic() + wait_s
    if not journal.exists() and wait_s > 0.0:
        click.echo(f"coilcal: waiting for {path}, which coilcal acquire begins", err=True)
    while not journal.exists() and time.monotonic() < deadline_s:
        time.sleep(POLL_S)


class LiveSession:
    """A session that grows, with its estimate, alarms, posterior and diagnosis."""

    def __init__(self, path: Path) -> None:
        self._path, self._engine = path, LiveEngine(path)
        self._last_s = time.monotonic()
        self._has_ended = False
        self._refreshed: Refreshed | None = None
        self._trouble: str | None = None

    def step(self, background: Background | None) -> bool:
        """Read and estimate new stops; while there are none, bring the estimate nearer to the batch fit.

        Returns: Whether more may come.
        """
        step = self._engine.step()
        if step is Step.READINGS:
            self._last_s = time.monotonic()
        elif step is Step.IDLE:
            time.sleep(POLL_S)
        elif step is Step.ENDED:
            self._has_ended = True
            return False
        if background is not None:
            self._take(background.take(), background)
            if background.wants(self._n_readings):
                background.offer(self._engine.session())
        return True

    def finish(self, background: Background | None) -> None:
        """Wait for the posterior and the verdict of the whole session."""
        if background is None:
            return
        click.echo("coilcal: the session is whole; posterior and diagnosis follow", err=True)
        self._take(background.last(self._engine.session()), background)
        while self._engine.stream.can_polish:
            self._engine.step()

    def state(self, background: Background | None) -> LiveState:
        """State to display."""
        engine = self._engine
        return LiveState(
            name=self._path.name,
            movers=engine.rig.movers,
            n_stops=int(engine.header.get("n_stops", 0)),
            entries=engine.entries,
            n_new=engine.n_new,
            silent_s=0.0 if self._has_ended else time.monotonic() - self._last_s,
            estimate=engine.estimate,
            alarms=engine.stream.alarms,
            refreshed=self._refreshed,
            is_refreshing=background is not None and background.is_busy,
            trouble=self._trouble,
            n_skipped=engine.stream.n_skipped,
        )

    def result(self) -> Mapping[str, Any]:
        """Result as JSON, for programs."""
        intervals = self._engine.stream.intervals()
        return {
            "session": str(self._path),
            "stops": len(self._engine.entries),
            "readings": 0 if self._engine.estimate is None else self._engine.estimate.n_readings,
            "skipped": self._engine.stream.n_skipped,
            "gaps": gaps_in(self._engine.entries),
            "is_polished": self._engine.stream.is_polished,
            "parameters": {name: asdict(interval) for name, interval in intervals.items()},
            "alarms": [{**asdict(alarm), "words": alarm.words} for alarm in self._engine.stream.alarms],
            "refreshed": None if self._refreshed is None else asdict(self._refreshed),
            "since": self.state(None).since,
            "trouble": self._trouble,
        }

    def text(self) -> str:
        """Result as text, for people."""
        intervals = self._engine.stream.intervals()
        state = self.state(None)
        lines = [state.progress]
        for name, show_as in displays(list(intervals)).items():
            interval, factor = intervals[name], show_as.factor
            value = with_sd(interval.value * factor, interval.sd * factor)
            lines.append(f"  {name:38} {value} {show_as.unit}".rstrip())
        lines += [f"estimate {state.standing}"] if state.standing else []
        lines += [f"alarm: {alarm.words}" for alarm in self._engine.stream.alarms] or ["no alarms"]
        lines.append(state.verdict)
        lines += [self._trouble] if self._trouble else []
        return "\n".join(lines)

    @property
    def _n_readings(self) -> int:
        """Readings of all sensors so far."""
        stream = self._engine.stream
        return stream.n_skipped + (0 if stream.observations is None else len(stream.observations))

    def _take(self, refreshed: Refreshed | None, background: Background) -> None:
        self._trouble = background.trouble
        if refreshed is not None:
            self._refreshed = refreshed
            self._engine.improve(refreshed.best)
