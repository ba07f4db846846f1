"""A measured quantity over repeats, beside its peer, and runs that take turns."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Row:
    """One quantity of one method, a value for each repeat.

    Attributes:
        ratio: Median over that of the peer, where there is a peer.
        extra: What else a program may want to know, such as R-hat.
    """

    name: str
    unit: str
    values: tuple[float, ...]
    ratio: float | None = None
    extra: Mapping[str, float] = field(default_factory=dict)

    @property
    def median(self) -> float:
        """Median over the repeats."""
        return statistics.median(self.values)

    def beside(self, peer: Row) -> Row:
        """This row with the ratio of its median to that of a peer."""
        return Row(self.name, self.unit, self.values, self.median / peer.median, self.extra)

    def to_json(self) -> dict[str, Any]:
        """Median and range, and all repeats."""
        return {
            "name": self.name,
            "unit": self.unit,
            "median": self.median,
            "smallest": min(self.values),
            "largest": max(self.values),
            "values": list(self.values),
            "ratio": self.ratio,
            **self.extra,
        }


def timed(call: Callable[[], Any], least_s: float = 0.0) -> float:
    """Seconds of the clock that a call takes: of one, or the mean of as many as `least_s` needs."""
    begin_s = time.perf_counter()
    n_calls = 0
    while n_calls == 0 or time.perf_counter() - begin_s < least_s:
        call()
        n_calls += 1
    return (time.perf_counter() - begin_s) / n_calls


def by_turns(
    calls: Mapping[str, Callable[[], Any]], repeats: int, least_s: float = 0.0
) -> dict[str, tuple[float, ...]]:
    """Seconds of each repeat of each call.

    Calls take turns, so that a busy moment of the machine affects all. The first turn loads and compiles, and does not count.
    """
    seconds: dict[str, list[float]] = {name: [] for name in calls}
    for turn in range(repeats + 1):
        for name, call in calls.items():
            taken_s = timed(call, least_s)
            if turn:
                seconds[name].append(taken_s)
    return {name: tuple(values) for name, values in seconds.items()}


def with_ratios(rows: Sequence[Row], peer: str) -> list[Row]:
    """Rows with their ratio to the row named `peer`; without it, as they are."""
    of_peer = next((row for row in rows if row.name == peer), None)
    return [row.beside(of_peer) for row in rows] if of_peer else list(rows)
