"""Shows what `coilcal live` knows: a screen on a terminal, plain lines in a pipe; always on standard error."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import click
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from estimator.cli.words import motion_words
from estimator.live.stream import Estimate
from estimator.live.watch import Alarm
from estimator.reporting.numbers import displays, to_digit_of, with_sd
from estimator.rig.bodies import Mover

if TYPE_CHECKING:
    from estimator.live.refresh import Refreshed

SCREENS_PER_S = 4
LINE_EVERY_S = 5.0
SILENT_S = 20.0  # without a stop after which a warning is shown
MOST_ALARMS = 8


@dataclass(frozen=True)
class LiveState:
    """All that is known at a moment.

    Attributes:
        name: Name of the session.
        movers: Movers of its rig.
        n_stops: Stops in the plan; 0 if unknown.
        entries: Stops so far, as the journal holds them.
        n_new: Stops in the last update; more than one if they came faster than the estimate could follow.
        silent_s: Time since the last stop.
        estimate: Latest estimate; None before the first reading.
        alarms: Alarms so far.
        refreshed: Latest posterior and verdict from the background.
        is_refreshing: Whether the next posterior and verdict are being made.
        trouble: Why the background failed last; None if it did not.
        n_skipped: Readings that the estimate does not use: for validation, or without any component.
    """

    name: str
    movers: Sequence[Mover]
    n_stops: int
    entries: Sequence[Mapping[str, Any]]
    n_new: int
    silent_s: float
    estimate: Estimate | None
    alarms: Sequence[Alarm]
    refreshed: Refreshed | None
    is_refreshing: bool
    trouble: str | None = None
    n_skipped: int = 0

    @property
    def progress(self) -> str:
        """How far the measurement is, and how well the estimate keeps up."""
        of = f" of {self.n_stops}" if self.n_stops else ""
        words = f"stop {len(self.entries)}{of}"
        if self.estimate is not None:
            words += f", estimate after {1e3 * self.estimate.took_s:.0f} ms"
        if self.n_new > 1:
            words += f" for {self.n_new} stops at once"
        if self.n_skipped:
            words += f"; {self.n_skipped} readings not fitted (validation, or no field)"
        if n_gaps := gaps_in(self.entries):
            words += f"; READINGS LOST BY AN INSTRUMENT {n_gaps} times"
        if self.silent_s > SILENT_S:
            words += f"; NO STOP FOR {self.silent_s:.0f} s"
        return words

    @property
    def standing(self) -> str:
        """How near the estimate is to what a fit of all readings at once would give."""
        if self.estimate is None:
            return ""
        words = (
            "polished: the same as a fit of all readings so far"
            if self.estimate.is_polished
            else "not polished yet: a fit of all readings so far may differ a little"
        )
        if missing := self.estimate.missing:
            labels = ", ".join(cause.label for cause in missing)
            words += (
                f"; it holds only where {labels} is absent, which these currents cannot tell from the coils"
            )
        return words

    @property
    def since(self) -> int | None:
        """First reading from which residuals are off; only alarms of the sensors that the diagnosis names count, if there are any."""
        lasting = [alarm for alarm in self.alarms if alarm.since < alarm.at]
        named = () if self.refreshed is None else self.refreshed.places
        of_named_sensors = [alarm for alarm in lasting if alarm.sensor in named]
        return min((alarm.since for alarm in of_named_sensors or lasting), default=None)

    @property
    def verdict(self) -> str:
        """Verdict of the latest diagnosis, with the first reading from which residuals are off."""
        if self.refreshed is None:
            return "diagnosis: not yet"
        words = f"diagnosis: {self.refreshed.words}"
        return words if self.since is None else f"{words}; residuals are off since reading {self.since}"


def gaps_in(entries: Sequence[Mapping[str, Any]]) -> int:
    """How often instruments lost readings; journals of earlier versions do not say."""
    return sum(sum(entry.get("n_gaps", {}).values()) for entry in entries)


def device_states(entry: Mapping[str, Any], movers: Sequence[Mover]) -> list[tuple[str, str]]:
    """Each instrument and its latest values, in words."""
    states = []
    for name, field_T in entry["field_T"].items():
        numbers = " ".join("over range" if b is None else f"{1e3 * b:+.3f}" for b in field_T)
        scatter_T = max((sd for sd in entry["sd_T"].get(name, []) if sd is not None), default=math.nan)
        settled = "settled" if entry["is_settled"] else "STILL CHANGING"
        lost = ", READINGS LOST" if entry.get("n_gaps", {}).get(name) else ""
        states.append((name, f"{numbers} mT, scatter {1e6 * scatter_T:.1f} µT, {settled}{lost}"))
    states += [(name, f"{current_A:+.4f} A") for name, current_A in entry["measured_A"].items()]
    for name, celsius in entry.get("temperature_C", {}).items():
        states.append((f"{name} temperature", "no number" if celsius is None else f"{celsius:.1f} °C"))
    states += [(mover.name, motion_words(mover, entry["motion"][mover.name])) for mover in movers]
    return states


def screen(state: LiveState) -> RenderableType:
    """The whole screen."""
    # Texts, not strings: in a string rich would read coil_heating[coil1] as a style.
    parts: list[RenderableType] = [Text(f"{state.name}  {state.progress}", style="bold")]
    if state.entries:
        devices = Table(box=None, show_header=False, padding=(0, 2))
        for name, words in device_states(state.entries[-1], state.movers):
            devices.add_row(Text(name), Text(words))
        parts.append(Panel(devices, title="instruments", title_align="left"))
    if state.estimate is not None:
        estimate = Group(_parameters(state), Text(state.standing))
        parts.append(Panel(estimate, title="estimate", title_align="left"))
    alarms = "\n".join(alarm.words for alarm in state.alarms[-MOST_ALARMS:])
    style = "bold red" if alarms else ""
    parts.append(
        Panel(Text(alarms or "none", style), title=f"alarms: {len(state.alarms)}", title_align="left")
    )
    parts.append(Text(state.verdict + (" (the next is being made)" if state.is_refreshing else "")))
    if state.trouble is not None:
        parts.append(Text(state.trouble, "bold red"))
    return Group(*parts)


def _parameters(state: LiveState) -> Table:
    assert state.estimate is not None
    table = Table(box=None, padding=(0, 2))
    refreshed = state.refreshed
    posterior = (
        f"90 % of the posterior after {refreshed.n_readings}" if refreshed else "90 % of the posterior"
    )
    for heading in ("parameter", "now", "90 % width", posterior):
        table.add_column(heading)
    intervals = state.estimate.intervals
    for name, show_as in displays(list(intervals)).items():
        interval, factor = intervals[name], show_as.factor
        sd = interval.sd * factor
        ci90 = refreshed.ci90.get(name) if refreshed else None
        table.add_row(
            show_as.words,
            f"{with_sd(interval.value * factor, sd)} {show_as.unit}",
            f"{factor * (interval.high - interval.low):.2g} {show_as.unit}",
            " to ".join(to_digit_of(sd, end * factor) for end in ci90) if ci90 else "not yet",
        )
    return table


class LiveView:
    """Shows each state of a session."""

    def __init__(self) -> None:
        self._printed_s = self._drawn_s = -math.inf
        self._n_alarms = 0
        self._verdict = ""
        self._trouble: str | None = None
        self._screen: Live | None = None
        if sys.stderr.isatty():
            console = Console(stderr=True)
            self._screen = Live(console=console, refresh_per_second=SCREENS_PER_S, transient=True)

    def __enter__(self) -> LiveView:
        if self._screen is not None:
            self._screen.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._screen is not None:
            self._screen.stop()

    def __call__(self, state: LiveState) -> None:
        """Show one state; in a pipe, each alarm, verdict and failure once, and the progress at intervals."""
        if self._screen is not None:
            if time.monotonic() - self._drawn_s >= 1.0 / SCREENS_PER_S:  # more would be made than are shown
                self._drawn_s = time.monotonic()
                self._screen.update(screen(state))
            return
        for alarm in state.alarms[self._n_alarms :]:
            click.echo(f"alarm: {alarm.words}", err=True)
        self._n_alarms = len(state.alarms)
        if state.refreshed is not None and state.verdict != self._verdict:
            self._verdict = state.verdict
            click.echo(state.verdict, err=True)
        if state.trouble != self._trouble:
            self._trouble = state.trouble
            if state.trouble is not None:
                click.echo(f"coilcal: {state.trouble}", err=True)
        if state.n_new and time.monotonic() - self._printed_s >= LINE_EVERY_S:
            self._printed_s = time.monotonic()
            click.echo(state.progress, err=True)
