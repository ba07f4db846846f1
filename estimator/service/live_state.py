"""The state of an open session, as the data of events: what was measured, by which instruments, and what fits say of it."""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

from estimator.live.engine import LiveEngine
from estimator.live.picture import CoilOutline, Place, outlines, places
from estimator.live.refresh import Refreshed
from estimator.live.stream import Interval
from estimator.rig.rig import Rig
from estimator.store.growing import observations_of
from estimator.store.journal import Entry
from estimator.store.made import JOURNAL

REDRAWN_AT = 1.25  # growth of a session after which the residuals of all its readings are computed anew
MOST_PLACES = 2_000  # that are shown, the last ones
HISTORY_STEP = 1.01  # growth of a session between two entries of its history
PACED, FEWEST_PACED = 50, 3  # readings that tell how often they come


@dataclass(frozen=True)
class Widths:
    """Standard deviation of every free parameter after a number of fitted readings."""

    n_readings: int
    sd: dict[str, float]


@dataclass(frozen=True)
class Verdict:
    """What a diagnosis of the first readings of a session says.

    Attributes:
        n_readings: Number of these readings.
        verdict: As in `diagnosis.json`.
        causes: Named causes, each with those that it cannot be told from.
        took_s: How long it took.
    """

    n_readings: int
    verdict: str
    causes: list[str]
    took_s: float


@dataclass(frozen=True)
class LiveState:
    """The state of an open session.

    Attributes:
        n_appended: Readings that were appended and taken.
        n_readings: Those of them that the estimate holds; the others are for validation.
        intervals: Of every free parameter; empty before the first reading.
        is_polished: Whether they are those of a batch fit of these readings, to 1e-6 standard deviations.
        alarms: All alarms so far, in words.
        alarm_readings: The first reading that each concerns, and that at which it was noticed.
        is_redrawn: Whether `places` and `history` are all there are; else they are those that are new.
        places: Where readings were taken, and what the estimate left of them when it was last computed.
        coils: Where the coils stood at the last reading.
        history: How the intervals shrank.
        devices: What each instrument showed last.
        diagnosis: The latest running diagnosis; None before the first.
        fault: Why no estimate can follow.
        has_ended: Whether nothing follows.
        silent_s: Time since the newest readings arrived; None before the first.
        pace_s: Usual time from one reading to the next; None before the third.
    """

    n_appended: int = 0
    n_readings: int = 0
    intervals: dict[str, Interval] = field(default_factory=dict)
    is_polished: bool = False
    alarms: list[str] = field(default_factory=list)
    alarm_readings: list[tuple[int, int]] = field(default_factory=list)
    is_redrawn: bool = False
    places: list[Place] = field(default_factory=list)
    coils: list[CoilOutline] = field(default_factory=list)
    history: list[Widths] = field(default_factory=list)
    devices: list[Device] = field(default_factory=list)
    diagnosis: Verdict | None = None
    fault: str | None = None
    has_ended: bool = False
    silent_s: float | None = None
    pace_s: float | None = None


@dataclass(frozen=True)
class Seen:
    """What a watcher has got already: the drawing, and its readings and its history up to a number."""

    drawing: int = -1
    n_places: int = 0
    n_history: int = 0


@dataclass(frozen=True)
class Drawn:
    """A state with all places and all history, and the number of the drawing, which grows when residuals are computed anew."""

    state: LiveState = field(default_factory=LiveState)
    drawing: int = 0
    n_drawn: int = 0

    def with_readings(self, engine: LiveEngine) -> Drawn:
        """The state after the engine took readings; old residuals are computed anew where the session has grown enough since."""
        before, estimate, rig = self.state, engine.estimate, engine.rig
        assert estimate is not None
        n, entries = len(engine.entries), engine.entries[-engine.n_new :]
        history = before.history
        if estimate.n_readings > HISTORY_STEP * (history[-1].n_readings if history else 0):
            sds = {name: interval.sd for name, interval in estimate.intervals.items()}
            history = [*history, Widths(estimate.n_readings, sds)]
        state = replace(
            with_estimate(before, engine),
            n_appended=n,
            n_readings=estimate.n_readings,
            places=[*before.places, *_places(engine, n - engine.n_new)][-MOST_PLACES:],
            coils=outlines(engine.stream.rig, engine.stream.values, observations_of(entries[-1:], rig)),
            history=history,
            devices=updated(before.devices, entries, rig),
        )
        if engine.has_more or n < REDRAWN_AT * self.n_drawn:
            return replace(self, state=state)
        return Drawn(replace(state, places=_places(engine, max(0, n - MOST_PLACES))), self.drawing + 1, n)

    def after(self, seen: Seen, engine: LiveEngine, path: Path) -> tuple[LiveState, Seen]:
        """The state for a watcher, and what that has got then.

        Args:
            seen: What it has got already.
            engine: Of the session.
            path: Its folder.
        """
        state, is_redrawn = self.state, seen.drawing != self.drawing
        n_places, n_history = (0, 0) if is_redrawn else (seen.n_places, seen.n_history)
        history = [widths for widths in state.history if widths.n_readings > n_history]
        told = replace(
            state,
            alarms=[alarm.words for alarm in engine.stream.alarms],
            alarm_readings=[(alarm.since, alarm.at) for alarm in engine.stream.alarms],
            is_redrawn=is_redrawn,
            places=[place for place in state.places if place.number > n_places],
            history=history,
            silent_s=_silent_s(path) if state.n_appended else None,
            pace_s=_pace_s(engine.entries[: state.n_appended]),
        )
        n_history = history[-1].n_readings if history else n_history
        return told, Seen(self.drawing, state.n_appended, n_history)


def with_estimate(state: LiveState, engine: LiveEngine) -> LiveState:
    """A state with the present intervals."""
    estimate = engine.estimate
    if estimate is None:
        return state
    return replace(state, intervals=dict(estimate.intervals), is_polished=estimate.is_polished)


def verdict_of(refreshed: Refreshed) -> Verdict:
    """A running diagnosis as an event tells of it."""
    return Verdict(refreshed.n_readings, refreshed.verdict, list(refreshed.causes), refreshed.took_s)


def _places(engine: LiveEngine, first: int) -> list[Place]:
    """Places by the present estimate, from an entry on. A stop of several sensors has one number."""
    entries = engine.entries[first:]
    numbers = [n for n, entry in enumerate(entries, start=first + 1) for _ in entry["field_T"]]
    return places(engine.stream.rig, engine.stream.values, observations_of(entries, engine.rig), numbers)


def _silent_s(path: Path) -> float | None:
    """Time since the journal was last written, however long ago somebody began to watch."""
    with suppress(OSError):
        return max(0.0, time.time() - (path / JOURNAL).stat().st_mtime)
    return None


def _pace_s(entries: Sequence[Entry]) -> float | None:
    """Usual time from one reading to the next; None where there are too few to tell."""
    times_s = [float(entry["time_s"]) for entry in entries[-PACED:]]
    return statistics.median(b - a for a, b in pairwise(times_s)) if len(times_s) >= FEWEST_PACED else None


Kind = Literal["sensor", "mover", "supply", "thermometer"]


@dataclass(frozen=True)
class Device:
    """What an instrument showed last.

    Attributes:
        kind: What it is.
        name: Sensor or mover that it is, coil that it feeds, or body whose temperature it measures.
        values: What it showed, in `unit`; None for a component out of range.
        unit: Unit of `values`: T, A or °C; m for the position of a mover, rad for the joints of one that reports these.
        commanded_A: Of a supply, the current that was asked for.
        n_readings: How often it was read.
        n_silent: Readings of the session since then, in which it is missing.
    """

    kind: Kind
    name: str
    values: list[float | None]
    unit: str
    commanded_A: float | None = None
    n_readings: int = 0
    n_silent: int = 0


def updated(devices: Sequence[Device], entries: Sequence[Mapping[str, Any]], rig: Rig) -> list[Device]:
    """The instruments after further entries of the journal, in the order in which they were met.

    Args:
        devices: The instruments before.
        entries: What was appended.
        rig: The rig of the session.
    """
    known = {(device.kind, device.name): device for device in devices}
    for entry in entries:
        known = {key: replace(device, n_silent=device.n_silent + 1) for key, device in known.items()}
        for device in _of_entry(entry, rig):
            key = device.kind, device.name
            n_before = known[key].n_readings if key in known else 0
            known[key] = replace(device, n_readings=n_before + 1)
    return list(known.values())


def _of_entry(entry: Mapping[str, Any], rig: Rig) -> Iterator[Device]:
    commanded_A = dict(zip((coil.name for coil in rig.coils), entry["current_A"], strict=True))
    for name, field_T in entry["field_T"].items():
        yield Device("sensor", name, list(field_T), "T")
    for mover in rig.movers:
        numbers = list(entry["motion"][mover.name])
        if mover.table is None:
            yield Device("mover", mover.name, numbers[:3], "m")
        else:
            yield Device("mover", mover.name, numbers, "rad")
    for name, measured_A in entry.get("measured_A", {}).items():
        yield Device("supply", name, [measured_A], "A", commanded_A[name])
    for name, temperature_C in entry.get("temperature_C", {}).items():
        yield Device("thermometer", name, [temperature_C], "°C")
