"""Averages readings of a sensor at a stop, once they say that the field has come to rest."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from statistics import fmean

import torch
from jaxtyping import Float
from torch import Tensor

from drivers.protocols import FieldSensor, Reading, ReadingFlag, Vector
from estimator.acquisition.pace import ANSWER_S, SETTLED_SIGMA, Pace
from estimator.errors import InvalidInput

FLOOR_T = 1e-9  # for a sensor whose readings do not scatter


@dataclass(frozen=True)
class Average:
    """Readings of one sensor at one stop.

    Attributes:
        mean_T, sd_T: Of each component.
        has_settled: Whether their two halves agreed in time.
        taken_s: When they were taken, on average, on the host's clock.
        n_gaps: How often the instrument lost readings meanwhile.
        answer_s: From question to answer, of the first.
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
    """Readings whose two halves agree, or the last ones there was time for.

    Args:
        sensor: To be read.
        name: For messages.
        pace: How many readings, and how long to wait for them to agree.
        taken_s: When a reading was taken, on the host's clock, from it and from when it had been asked for.
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
            dated_s = fmean(taken_s(reading, asked_s) for reading in values)
            return Average(field_T.mean(0), field_T.std(dim=0), has_settled, dated_s, n_gaps, answer_s)
        values = values[n // 2 :]


def is_settled(field_T: Float[Tensor, "reading component"]) -> bool:
    """Whether the two halves of readings that followed each other agree within what their scatter allows (`estimator.acquisition.pace`)."""
    n = len(field_T)
    step_T = (field_T[n // 2 :].mean(0) - field_T[: n // 2].mean(0)).abs()
    # Scatter by neighbours (von Neumann, Ann. Math. Stat. 12 (1941) 367): a slow change hardly widens it.
    scatter_T = (field_T.diff(dim=0).square().mean(0) / 2.0).sqrt()
    return not bool((step_T > FLOOR_T + SETTLED_SIGMA * 2.0 * scatter_T / math.sqrt(n)).any())


def _add(sensor: FieldSensor, name: str, values: list[Reading[Vector]], n: int) -> int:
    """Add readings that are new until there are enough; how often the instrument lost some."""
    deadline_s = time.monotonic() + ANSWER_S * n
    n_gaps = 0
    while len(values) < n:
        new = sensor.read_new_T(timeout_s=ANSWER_S)
        n_gaps += sum(ReadingFlag.DROPPED in reading.flags for reading in new)
        values += [reading for reading in new if ReadingFlag.STALE not in reading.flags]
        if time.monotonic() > deadline_s:
            raise InvalidInput(
                f"{name} must give {n} new readings within {ANSWER_S * n:g} s; {len(values)} came"
            )
    del values[n:]
    return n_gaps


def _components_T(reading: Reading[Vector]) -> Vector:
    """NaN for what left the range; all three where the sensor does not say which of them."""
    is_marked = any(math.isnan(value_T) for value_T in reading.value)
    if ReadingFlag.OVER_RANGE in reading.flags and not is_marked:
        return math.nan, math.nan, math.nan
    return reading.value
