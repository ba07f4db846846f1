"""Averages readings of a sensor at a stop, once they show that the field has settled, and dates them by the clock of their instrument."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from statistics import fmean

import torch
from jaxtyping import Float
from torch import Tensor

from drivers.protocols import FieldSensor, Reading, ReadingFlag, Vector
from estimator.acquisition.pace import ANSWER_S, SETTLED_SIGMA, Pace
from estimator.errors import InvalidInput
from estimator.units import LARGEST

FLOOR_T = 1e-9  # difference that is always allowed, for sensors whose readings do not scatter


@dataclass(frozen=True)
class Average:
    """Average of the readings of one sensor at one stop.

    Attributes:
        mean_T, sd_T: Mean and standard deviation of each component.
        has_settled: Whether the two halves of the readings agreed in time.
        taken_s: Mean time of the readings, on the host's clock.
        n_gaps: How often the instrument lost readings meanwhile.
        answer_s: Time from question to answer of the first reading.
    """

    mean_T: Tensor
    sd_T: Tensor
    has_settled: bool
    taken_s: float
    n_gaps: int
    answer_s: float


def average(
    sensor: FieldSensor, name: str, pace: Pace, taken_s: Callable[[Reading[Vector], float], float]
) -> Average:
    """Average readings whose two halves agree, or the last readings if time runs out.

    Args:
        sensor: Sensor to read.
        name: Its name, for messages.
        pace: Number of readings, and how long to wait for them to agree.
        taken_s: Time at which a reading was taken, on the host's clock, from the reading and the time of the request.
    Raises:
        InvalidInput: The sensor gives no new reading.
    """
    n = pace.n_readings
    asked_s = time.monotonic()
    values, n_gaps = [sensor.read_field_T(timeout_s=ANSWER_S)], 0
    answer_s = time.monotonic() - asked_s
    while True:
        n_gaps += _add(sensor, name, values, n)
        field_T = torch.tensor([_components_T(reading) for reading in values]).double()
        has_settled = is_settled(field_T)
        if has_settled or time.monotonic() > asked_s + pace.longest_settle_s:
            mean_time_s = fmean(taken_s(reading, asked_s) for reading in values)
            return Average(field_T.mean(0), field_T.std(dim=0), has_settled, mean_time_s, n_gaps, answer_s)
        values = values[n // 2 :]


def is_settled(field_T: Float[Tensor, "reading component"]) -> bool:
    """Whether the two halves of successive readings agree within what their scatter allows (`estimator.acquisition.pace`)."""
    n = len(field_T)
    step_T = (field_T[n // 2 :].mean(0) - field_T[: n // 2].mean(0)).abs()
    # Scatter from successive differences (von Neumann, Ann. Math. Stat. 12 (1941) 367): a slow drift hardly widens it.
    scatter_T = (field_T.diff(dim=0).square().mean(0) / 2.0).sqrt()
    return not bool((step_T > FLOOR_T + SETTLED_SIGMA * 2.0 * scatter_T / math.sqrt(n)).any())


def _add(sensor: FieldSensor, name: str, values: list[Reading[Vector]], n: int) -> int:
    """Append new readings until there are `n`; return how often the instrument lost some."""
    deadline_s = time.monotonic() + ANSWER_S * n
    n_gaps = 0
    while len(values) < n:
        new = sensor.read_new_T(timeout_s=ANSWER_S)
        n_gaps += sum(ReadingFlag.DROPPED in reading.flags for reading in new)
        values += [reading for reading in new if ReadingFlag.STALE not in reading.flags]
        if time.monotonic() > deadline_s:
            raise InvalidInput(
                f"{name} must give {n} new readings within {ANSWER_S * n:g} s; it gave {len(values)}"
            )
    del values[n:]
    return n_gaps


def _components_T(reading: Reading[Vector]) -> Vector:
    """Components of a reading, NaN if out of range; all three are NaN if the sensor does not say which one is."""
    x_T, y_T, z_T = map(measured, reading.value)
    if ReadingFlag.OVER_RANGE in reading.flags and not any(map(math.isnan, (x_T, y_T, z_T))):
        return math.nan, math.nan, math.nan
    return x_T, y_T, z_T


def measured(value: float) -> float:
    """A number that an instrument gave; NaN where it stands for none, such as 9.9e37 of SCPI (1999, section 7.2.1.5).

    Examples:
        >>> measured(0.002), measured(9.91e37)
        (0.002, nan)
    """
    return value if abs(value) <= LARGEST else math.nan


WINDOW = 200
"""Readings over which both clocks are taken to run at the same rate: 100 ppm make a millisecond in ten seconds."""

LONGEST_DELAY_S = 2.0
"""After a longer apparent delay, the instrument's clock is taken to have been set."""

SLACK_S = 0.05
"""Contradiction that is allowed between two readings: clocks have a resolution, and their rates differ."""


class DeviceClock:
    """Offset of an instrument's clock from the host's, and delay of its readings.

    Of the recent readings, the one that arrived fastest gives the offset, up to the shortest latency of a message: that part cannot be
    seen from one side (Mills, Network Time Protocol, RFC 5905, section 8). The time of the request bounds the offset from the other
    side, for a reading is taken after its request and before its arrival. If the bounds of two readings contradict each other, the
    instrument's clock was set in between, and only the new setting counts from then on.

    Examples:
        >>> clock = DeviceClock()
        >>> for host_s, device_s in ((100.003, 0.0), (100.101, 0.1), (100.209, 0.2)):
        ...     clock.add(host_s, device_s)
        >>> round(clock.offset_s, 6), round(clock.delay_s, 6), round(clock.on_host_s(0.2), 6)
        (100.001, 0.003333, 100.201)
    """

    def __init__(self) -> None:
        # Lower and upper bound of the offset from each reading.
        self._bounds_s: deque[tuple[float, float]] = deque(maxlen=WINDOW)

    def add(self, host_s: float, device_s: float, asked_s: float = -math.inf) -> None:
        """Take a reading into account.

        Args:
            host_s: Arrival, on the host's clock.
            device_s: Time stamp, on the instrument's clock.
            asked_s: Time of the request, before the reading was taken, on the host's clock.
        """
        low_s, high_s = asked_s - device_s, host_s - device_s
        if self._bounds_s:
            lowest_s = max(low_s for low_s, _ in self._bounds_s)
            is_set = low_s > self.offset_s + SLACK_S or high_s < lowest_s - SLACK_S
            if is_set or abs(high_s - self.offset_s) > LONGEST_DELAY_S:
                self._bounds_s.clear()
        self._bounds_s.append((low_s, high_s))

    @property
    def offset_s(self) -> float:
        """Host's clock minus the instrument's clock."""
        return min(high_s for _, high_s in self._bounds_s)

    @property
    def delay_s(self) -> float:
        """Mean delay of the readings relative to the fastest one."""
        return fmean(high_s for _, high_s in self._bounds_s) - self.offset_s

    def on_host_s(self, device_s: float) -> float:
        """Convert a time of the instrument to the host's clock."""
        return device_s + self.offset_s
