"""What a watcher of an open session is told: the data of its events."""

from __future__ import annotations

from dataclasses import dataclass, field

from estimator.live.outlines import CoilOutline
from estimator.live.places import Place
from estimator.live.stream import Interval
from estimator.service.devices import Device


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
class News:
    """What a watcher is told.

    Attributes:
        n_appended: Readings that were appended and taken.
        n_readings: Those of them that the estimate holds; the others are for validation.
        intervals: Of every free parameter; empty before the first reading.
        is_polished: Whether they are those of a batch fit of these readings, to 1e-6 standard deviations.
        alarms: All alarms so far, in words.
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
