"""`coilcal live`: a session that is being measured, estimated and watched while it grows."""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from estimator.cli.live_view import LiveState, LiveView, gaps_in
from estimator.cli.options import json_option, seed_option
from estimator.cli.output import explain_errors, show
from estimator.live.refresh import Background, Refreshed
from estimator.live.stream import Estimate, Stream
from estimator.reporting.plots.style import displays, with_sd
from estimator.store.follow import Follower
from estimator.store.growing import observations_of
from estimator.store.journal import JOURNAL, Record
from estimator.store.session import Session

POLL_S = 0.01


@click.command("live")
@click.argument("session_path", metavar="SESSION", type=click.Path(path_type=Path))
@click.option(
    "--wait",
    "wait_s",
    type=click.FloatRange(min=0.0),
    default=3600.0,
    show_default=True,
    help="Seconds to wait for a session that is not there yet; Ctrl-C ends it.",
)
@click.option(
    "--refresh/--no-refresh",
    "has_refresh",
    default=True,
    show_default=True,
    help="Sample the posterior and look for causes in the background.",
)
@seed_option
@json_option
@explain_errors
def live_command(session_path: Path, wait_s: float, has_refresh: bool, seed: int, as_json: bool) -> None:
    """Follow SESSION while coilcal acquire writes it, in another terminal or on another computer that sees its folder.

    Each stop updates the estimate and its credible intervals within milliseconds; readings that noise would not make raise alarms; the
    posterior and the diagnosis follow in the background. It ends with the session, or with Ctrl-C, which leaves the measurement alone.
    """
    _wait_for(session_path, wait_s)
    live = _Live(session_path)
    with LiveView() as view, ExitStack() as stack:
        background = stack.enter_context(Background(seed)) if has_refresh else None
        try:
            while live.step(background):
                view(live.state(background))
            live.finish(background)
            view(live.state(None))
        except KeyboardInterrupt:
            click.echo("coilcal: the measurement goes on without being watched", err=True)
    show(live.result(), live.text(), as_json)


class _Live:
    """A session that is followed."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._follower = Follower(path)
        self._rig = self._follower.rig
        self._stream = Stream(self._rig)
        self._records: list[Record] = []
        self._n_new, self._n_readings, self._has_ended = 0, 0, False
        self._last_s = time.monotonic()
        self._estimate: Estimate | None = None
        self._refreshed: Refreshed | None = None
        self._trouble: str | None = None

    def step(self, background: Background | None) -> bool:
        """Take what is new; whether there may be more."""
        has_ended = self._follower.has_ended
        new = self._follower.records()
        self._n_new = len(new)
        if new:
            readings = observations_of(new, self._rig)
            self._estimate = self._stream.update(readings)
            self._n_readings += len(readings)
            self._records += new
            self._last_s = time.monotonic()
        elif has_ended:
            self._has_ended = True
            return False
        else:
            time.sleep(POLL_S)
        if background is not None:
            self._take(background.take(), background)
            if background.wants(self._n_readings):
                background.offer(self._session())
        return True

    def finish(self, background: Background | None) -> None:
        """Wait for posterior and verdict of the whole session."""
        if background is None:
            return
        click.echo("coilcal: the session is whole; posterior and diagnosis follow", err=True)
        self._take(background.last(self._session()), background)

    def state(self, background: Background | None) -> LiveState:
        """For the view."""
        return LiveState(
            self._path.name,
            self._rig.movers,
            int(self._follower.header.get("n_stops", 0)),
            self._records,
            self._n_new,
            0.0 if self._has_ended else time.monotonic() - self._last_s,
            self._estimate,
            self._stream.alarms,
            self._refreshed,
            background is not None and background.is_busy,
            self._trouble,
            self._stream.n_skipped,
        )

    def result(self) -> Mapping[str, Any]:
        """For programs."""
        intervals = self._stream.intervals()
        return {
            "session": str(self._path),
            "stops": len(self._records),
            "readings": 0 if self._estimate is None else self._estimate.n_readings,
            "skipped": self._stream.n_skipped,
            "gaps": gaps_in(self._records),
            "parameters": {name: asdict(interval) for name, interval in intervals.items()},
            "alarms": [{**asdict(alarm), "words": alarm.words} for alarm in self._stream.alarms],
            "refreshed": None if self._refreshed is None else asdict(self._refreshed),
            "since": self.state(None).since,
            "trouble": self._trouble,
        }

    def text(self) -> str:
        """For people."""
        intervals = self._stream.intervals()
        lines = [self.state(None).progress]
        for name, show_as in displays(list(intervals)).items():
            one, factor = intervals[name], show_as.factor
            lines.append(
                f"  {name:38} {with_sd(one.value * factor, one.sd * factor)} {show_as.unit}".rstrip()
            )
        lines += [f"alarm: {alarm.words}" for alarm in self._stream.alarms] or ["no alarms"]
        lines.append(self.state(None).verdict)
        lines += [self._trouble] if self._trouble else []
        return "\n".join(lines)

    def _take(self, refreshed: Refreshed | None, background: Background) -> None:
        self._trouble = background.trouble
        if refreshed is not None:
            self._refreshed = refreshed
            self._stream.improve(refreshed.best)

    def _session(self) -> Session:
        return Session(self._rig, observations_of(self._records, self._rig), self._follower.header["source"])


def _wait_for(path: Path, wait_s: float) -> None:
    deadline_s = time.monotonic() + wait_s
    if not (path / JOURNAL).exists() and wait_s > 0.0:
        click.echo(f"coilcal: waiting for {path}, which coilcal acquire begins", err=True)
    while not (path / JOURNAL).exists() and time.monotonic() < deadline_s:
        time.sleep(POLL_S)
