"""Readings that cannot have been measured as they were recorded: which, why, and the session without them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import groupby
from typing import Any

from jaxtyping import Int

from estimator.readings.observations import Observations
from estimator.tensors import Tensor, torch

COMPONENTS = ("x", "y", "z")
MOST_STRETCHES = 4  # that are listed one by one


class Reason(StrEnum):
    """Why a reading was flagged; the words are stable (docs/file-formats.md)."""

    COPIED = "copied"
    HELD = "held"
    FILLED_IN = "filled_in"
    STUCK_BIT = "stuck_bit"
    SENTINEL = "sentinel"
    WRAPPED = "wrapped"
    OTHERWISE = "otherwise"


@dataclass(frozen=True)
class Flag:
    """Readings of one sensor that cannot have been measured as they were recorded, all for one reason.

    Attributes:
        reason: Why.
        words: What is wrong with them, as a clause.
        sensor: Index of the sensor.
        component: Index of the component that is concerned; None where all three are.
        readings: Numbers of the readings in the session, from 0.
        stretches: First and last of each run of them, in the order in which the sensor was read.
        lines: Lines of the file that these readings were imported from; empty where there is none.
    """

    reason: Reason
    words: str
    sensor: int
    component: int | None
    readings: tuple[int, ...]
    stretches: tuple[tuple[int, int], ...]
    lines: tuple[int, ...] = ()

    @classmethod
    def of(
        cls,
        observations: Observations,
        reason: Reason,
        words: str,
        component: int | None,
        readings: Sequence[int],
    ) -> Flag:
        """The flag of some readings of one sensor.

        Args:
            observations: The session.
            reason, words, component: As above.
            readings: Numbers in it of at least one reading.
        """
        sensor = int(observations.sensor[readings[0]])
        own = in_time(observations, sensor).tolist()
        place = {reading: number for number, reading in enumerate(own)}
        runs = runs_of(sorted(place[reading] for reading in readings))
        stretches = tuple((own[run[0]], own[run[-1]]) for run in runs)
        numbers = tuple(sorted(readings))
        lines = () if observations.line is None else tuple(observations.line[list(numbers)].tolist())
        return cls(reason, words, sensor, component, numbers, stretches, lines)

    @property
    def is_everywhere(self) -> bool:
        """Whether it concerns all readings of the sensor, so that leaving them out would leave nothing."""
        return self.reason is Reason.STUCK_BIT

    def where(self) -> str:
        """The readings as stretches: by line where they were imported from a file, else counted from 1.

        Examples:
            >>> Flag(Reason.HELD, "", 0, 2, (4, 5, 6, 9), ((4, 6), (9, 9))).where()
            'readings 5 to 7 and 10'
            >>> Flag(Reason.HELD, "", 0, 2, tuple(range(0, 12, 2)), tuple((i, i) for i in range(0, 12, 2))).where()
            '6 readings between 1 and 11'
            >>> Flag(Reason.HELD, "", 0, 2, (4, 5, 6), ((4, 6),), (7, 8, 10)).where()
            'lines 7 to 10'
        """
        number = dict(
            zip(self.readings, self.lines or (reading + 1 for reading in self.readings), strict=True)
        )
        unit = "line" if self.lines else "reading"
        if len(self.stretches) > MOST_STRETCHES:
            between = f"{number[self.readings[0]]} and {number[self.readings[-1]]}"
            return f"{len(self.readings)} readings between {'lines ' if self.lines else ''}{between}"
        shown = [
            f"{number[first]}" if first == last else f"{number[first]} to {number[last]}"
            for first, last in self.stretches
        ]
        listed = " and ".join(part for part in (", ".join(shown[:-1]), shown[-1]) if part)
        return f"{unit if len(self.readings) == 1 else f'{unit}s'} {listed}"

    def subject(self, sensors: Sequence[str]) -> str:
        """The fields that are concerned, such as `z of hall`."""
        axis = "" if self.component is None else f"{COMPONENTS[self.component]} of "
        return axis + sensors[self.sensor]

    def clause(self, sensors: Sequence[str]) -> str:
        """What is wrong, and in which readings.

        Args:
            sensors: Names of the sensors, in order.

        Examples:
            >>> Flag(Reason.HELD, "repeats the reading before", 0, 2, (4,), ((4, 4),)).clause(["hall"])
            'z of hall repeats the reading before, in reading 5'
        """
        return f"{self.subject(sensors)} {self.words}, in {'all its readings' if self.is_everywhere else self.where()}"

    def to_json(self, sensors: Sequence[str]) -> dict[str, Any]:
        """The flag in the form of JSON; readings are counted from 1, lines are those of the file."""
        return {
            "reason": str(self.reason),
            "words": self.words,
            "sensor": sensors[self.sensor],
            "component": None if self.component is None else COMPONENTS[self.component],
            "readings": [reading + 1 for reading in self.readings],
            "lines": list(self.lines),
        }


def merged(observations: Observations, flags: Sequence[Flag]) -> list[Flag]:
    """The flags in order of their readings; those that say the same of a sensor as one."""
    alike: dict[tuple[str, int, int | None], list[Flag]] = {}
    for flag in flags:
        alike.setdefault((flag.words, flag.sensor, flag.component), []).append(flag)
    result = [
        same[0]
        if len(same) == 1
        else Flag.of(
            observations,
            same[0].reason,
            same[0].words,
            same[0].component,
            sorted({reading for flag in same for reading in flag.readings}),
        )
        for same in alike.values()
    ]
    return sorted(result, key=lambda flag: flag.readings)


def without_flagged(observations: Observations, flags: Sequence[Flag]) -> Observations:
    """The session with what was flagged as if it had not been measured; a component that is wrong everywhere stays.

    Args:
        observations: A whole session, as it was flagged.
        flags: Of its readings.
    """
    wrong = torch.zeros_like(observations.is_measured)
    for flag in flags:
        if not flag.is_everywhere:
            components = slice(None) if flag.component is None else flag.component
            wrong[list(flag.readings), components] = True
    if not bool(wrong.any()):
        return observations
    return observations.with_field(observations.field_sensor_T.masked_fill(wrong, torch.nan))


def told(flags: Sequence[Flag], sensors: Sequence[str], of_what: str = "") -> str:
    """A sentence about readings that were flagged, of this or of something else; empty where none was."""
    if not flags:
        return ""
    return f"Readings{of_what} are not as they were measured: {'; '.join(flag.clause(sensors) for flag in flags)}."


def in_time(observations: Observations, sensor: int) -> Int[Tensor, " own"]:
    """Numbers of the readings of a sensor, in order of time."""
    own = (observations.sensor == sensor).nonzero().flatten()
    return own[observations.time_s[own].argsort(stable=True)]


def runs_of(numbers: Sequence[int]) -> list[list[int]]:
    """Ascending numbers, cut where one does not follow its predecessor.

    Examples:
        >>> runs_of([4, 5, 6, 9])
        [[4, 5, 6], [9]]
    """
    runs = groupby(enumerate(numbers), key=lambda pair: pair[1] - pair[0])
    return [[number for _, number in run] for _, run in runs]
