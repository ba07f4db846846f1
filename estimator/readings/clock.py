"""Times of readings as clocks write them: stamps that are shared, clocks that were set back, and what can be made of them."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from enum import StrEnum

import numpy as np
import numpy.typing as npt

from estimator.errors import listed

Times = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
MOST_TOLD = 3  # jumps that a sentence lists


def now() -> str:
    """The present time, as sessions write it: in UTC, to the second."""
    return datetime.now(UTC).isoformat(timespec="seconds")


class Clock(StrEnum):
    """How times are read; the words are stable (docs/file-formats.md)."""

    AS_WRITTEN = "as-written"
    CONTINUE = "continue"
    SPREAD = "spread"
    ROWS = "rows"


def read_clock(time_s: Times, sensor: Indices, clock: Clock) -> Times:
    """Times of rows in the order of a file.

    Args:
        time_s: As written.
        sensor: Index of the sensor of each row; the rows of each are in order.
        clock: `continue` goes on behind each jump back by the median step, `spread` shares out the rows of one stamp evenly up to the
            next, `rows` counts the readings of each sensor instead.
    Examples:
        >>> none = np.zeros(4, dtype=np.int64)
        >>> read_clock(np.array([0.0, 2.0, 0.0, 2.0]), none, Clock.CONTINUE).tolist()
        [0.0, 2.0, 4.0, 6.0]
        >>> read_clock(np.array([0.0, 0.0, 1.0, 1.0]), none, Clock.SPREAD).tolist()
        [0.0, 0.5, 1.0, 1.5]
    """
    if clock is Clock.AS_WRITTEN:
        return time_s
    read_s = time_s.copy()
    for index in np.unique(sensor):
        own = np.flatnonzero(sensor == index)
        if clock is Clock.ROWS:
            read_s[own] = np.arange(len(own))
        elif clock is Clock.CONTINUE:
            read_s[own] = _continued(time_s[own])
        else:
            read_s[own] = _spread(time_s[own])
    return read_s


def _continued(time_s: Times) -> Times:
    steps = np.diff(time_s)
    forward = steps[steps > 0.0]
    usual = float(np.median(forward)) if len(forward) else 1.0
    late = np.where(steps < 0.0, usual - steps, 0.0)
    return time_s + np.concatenate(([0.0], np.cumsum(late)))


def _spread(time_s: Times) -> Times:
    starts = np.flatnonzero(np.concatenate(([True], np.diff(time_s) != 0.0)))
    counts = np.diff(np.append(starts, len(time_s)))
    steps = np.diff(time_s[starts])
    forward = steps[steps > 0.0]
    usual = float(np.median(forward)) if len(forward) else 1.0
    lasting = np.append(steps, usual)
    lasting = np.where(lasting > 0.0, np.minimum(lasting, usual), usual)  # a pause is none of the stamps'
    place = np.arange(len(time_s)) - np.repeat(starts, counts)
    return time_s + place * np.repeat(lasting / counts, counts)


def jumps_back(time_s: Times, sensor: Indices) -> list[int]:
    """Rows whose time is before that of the sensor's row above."""
    rows: list[int] = []
    for index in np.unique(sensor):
        own = np.flatnonzero(sensor == index)
        rows += own[1:][np.diff(time_s[own]) < 0.0].tolist()
    return sorted(rows)


def told_of_clock(time_s: Times, sensor: Indices, lines: Sequence[int] | Indices) -> str:
    """A sentence about times that jump back; empty where none does.

    Args:
        time_s, sensor: As for `read_clock`.
        lines: Line of each row.
    Examples:
        >>> told_of_clock(np.array([0.0, 1.0, 0.5]), np.zeros(3, dtype=np.int64), [2, 3, 4])
        'Time jumps back in line 4 (to 0.5 s): if a clock was set back there, import with --clock continue.'
    """
    rows = jumps_back(time_s, sensor)
    if not rows:
        return ""
    first = (f"line {lines[row]} (to {time_s[row]:.10g} s)" for row in rows[:MOST_TOLD])
    return f"Time jumps back in {listed(first, len(rows))}: if a clock was set back there, import with --clock continue."
