"""A session that `coilcal live` follows: new stops go to the stream, and to posterior and diagnosis in the background."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from estimator.cli.live_view import LiveState, gaps_in
from estimator.live.spare import SpareTime
from estimator.live.stream import Estimate, Stream
from estimator.reporting.numbers import displays, with_sd
from estimator.store.follow import Follower
from estimator.store.growing import observations_of
from estimator.store.journal import Entry
from estimator.store.made import JOURNAL
from estimator.store.session import Session

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
        self._path = path
        self._follower = Follower(path)
        self._rig = self._follower.rig
        self._stream, self._spare = Stream(self._rig), SpareTime()
        self._entries: list[Entry] = []
        self._n_new, self._n_readings, self._has_ended = 0, 0, False
        self._last_s = time.monotonic()
        self._estimate: Estimate | None = None
        self._refreshed: Refreshed | None = None
        self._trouble: str | None = None

    def step(self, background: Background | None) -> bool:
        """Read and estimate the new stops; while there are none, bring the estimate nearer to the batch fit.

        Returns: Whether more may come.
        """
        has_ended = self._follower.has_ended
        new_entries = self._follower.entries()
        self._n_new = len(new_entries)
        if new_entries:
            readings = observations_of(new_entries, self._rig)
            self._estimate = self._stream.update(readings)
            self._n_readings += len(readings)
            self._entries += new_entries
            self._last_s = time.monotonic()
        elif has_ended:
            self._has_ended = True
            while self._stream.can_polish:
                self._polish()
            return False
        elif self._stream.can_polish and self._spare.is_left():
            self._polish()
        else:
            time.sleep(POLL_S)
        if background is not None:
            self._take(background.take(), background)
            if background.wants(self._n_readings):
                background.offer(self._session())
        return True

    def finish(self, background: Background | None) -> None:
        """Wait for the posterior and the verdict of the whole session."""
        if background is None:
            return
        click.echo("coilcal: the session is whole; posterior and diagnosis follow", err=True)
        self._take(background.last(self._session()), background)

    def state(self, background: Background | None) -> LiveState:
        """State to display."""
        return LiveState(
            name=self._path.name,
            movers=self._rig.movers,
            n_stops=int(self._follower.header.get("n_stops", 0)),
            entries=self._entries,
            n_new=self._n_new,
            silent_s=0.0 if self._has_ended else time.monotonic() - self._last_s,
            estimate=self._estimate,
            alarms=self._stream.alarms,
            refreshed=self._refreshed,
            is_refreshing=background is not None and background.is_busy,
            trouble=self._trouble,
            n_skipped=self._stream.n_skipped,
        )

    def result(self) -> Mapping[str, Any]:
        """Result as JSON, for programs."""
        intervals = self._stream.intervals()
        return {
            "session": str(self._path),
            "stops": len(self._entries),
            "readings": 0 if self._estimate is None else self._estimate.n_readings,
            "skipped": self._stream.n_skipped,
            "gaps": gaps_in(self._entries),
            "is_polished": self._stream.is_polished,
            "parameters": {name: asdict(interval) for name, interval in intervals.items()},
            "alarms": [{**asdict(alarm), "words": alarm.words} for alarm in self._stream.alarms],
            "refreshed": None if self._refreshed is None else asdict(self._refreshed),
            "since": self.state(None).since,
            "trouble": self._trouble,
        }

    def text(self) -> str:
        """Result as text, for people."""
        intervals = self._stream.intervals()
        state = self.state(None)
        lines = [state.progress]
        for name, show_as in displays(list(intervals)).items():
            interval, factor = intervals[name], show_as.factor
            value = with_sd(interval.value * factor, interval.sd * factor)
            lines.append(f"  {name:38} {value} {show_as.unit}".rstrip())
        lines += [f"estimate {state.standing}"] if state.standing else []
        lines += [f"alarm: {alarm.words}" for alarm in self._stream.alarms] or ["no alarms"]
        lines.append(state.verdict)
        lines += [self._trouble] if self._trouble else []
        return "\n".join(lines)

    def _take(self, refreshed: Refreshed | None, background: Background) -> None:
        self._trouble = background.trouble
        if refreshed is not None:
            self._refreshed = refreshed
            self._stream.improve(refreshed.best)
            self._show_again()
            while self._has_ended and self._stream.can_polish:
                self._polish()

    def _polish(self) -> None:
        if self._stream.polish() and self._stream.is_polished:
            self._show_again()

    def _show_again(self) -> None:
        """Show the estimate where it has moved to without a new reading."""
        if self._estimate is not None:
            intervals, is_polished = self._stream.intervals(), self._stream.is_polished
            self._estimate = replace(self._estimate, intervals=intervals, is_polished=is_polished)

    def _session(self) -> Session:
        return Session(self._rig, observations_of(self._entries, self._rig), self._follower.header["source"])
