"""Alarms on readings as they arrive: one improbable reading, or many that are off in the same direction, and since when.

The innovation of a reading, its difference from the prediction by all readings before it, is noise of known size while the model holds.
Page's cumulative sum detects a lasting shift of it early; the shift began where the sum began to rise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import torch
from scipy.special import chdtrc  # what scipy.stats calls, without its long import
from torch import Tensor

from estimator.inference.linearisation import Innovation
from estimator.readings.observations import Observations
from estimator.rig.rig import Rig

IMPROBABLE = 1e-6  # probability of a reading by noise alone that raises an alarm: one false alarm in a million readings
SHIFT_SIGMA = 1.0  # the shift that the sum detects earliest
# One false alarm of a sum in about 900 000 readings: Siegmund, Sequential Analysis (1985), eq 2.59.
LIMIT = 12.0
# A weaker field, in its uncertainty, has no clear direction along which its strength could shift.
FIELD_SIGMA = 5.0
ALONG = "the strength of the field"


@dataclass(frozen=True)
class Alarm:
    """A deviation of readings that noise alone makes improbable.

    Attributes:
        sensor: Sensor of these readings.
        what: Component, or `ALONG`.
        since: Number of the first reading concerned, from 1.
        at: Number of the reading at which it was noticed.
        size_sigma: Mean deviation in standard deviations.
    """

    sensor: str
    what: str
    since: int
    at: int
    size_sigma: float

    @property
    def words(self) -> str:
        """The alarm as an operator reads it.

        Examples:
            >>> Alarm("hall", "x", 210, 224, 1.8).words
            'hall: x is off by +1.8 sigma since reading 210 (noticed at 224)'
            >>> Alarm("hall", "x, y and z", 7, 7, 9.0).words
            'hall: reading 7 is improbable, +9.0 sigma off in x, y and z'
        """
        if self.since == self.at:
            return f"{self.sensor}: reading {self.at} is improbable, {self.size_sigma:+.1f} sigma off in {self.what}"
        return f"{self.sensor}: {self.what} is off by {self.size_sigma:+.1f} sigma since reading {self.since} (noticed at {self.at})"


@dataclass
class _Sum:
    """Page's one-sided cumulative sum of numbers that should be standard normal.

    References: Page, Biometrika 41 (1954) 100.
    """

    sign: float
    height: float = 0.0
    total: float = 0.0
    numbers: list[int] = field(default_factory=list)
    noticed_at: int | None = None

    def add(self, number: int, value: float) -> bool:
        """Add a reading; True if the sum passes the limit with it."""
        self.height += self.sign * value - 0.5 * SHIFT_SIGMA
        if self.height <= 0.0:
            self.height, self.total, self.noticed_at = 0.0, 0.0, None
            self.numbers.clear()
            return False
        self.total += value
        self.numbers.append(number)
        if self.noticed_at is None and self.height > LIMIT:
            self.noticed_at = number
            return True
        return False


class Watch:
    """Alarms about the readings of one rig.

    Attributes:
        alarms: In the order in which they were noticed.
    """

    def __init__(self, rig: Rig) -> None:
        self._sensors = [sensor.name for sensor in rig.sensors]
        self._sums: dict[tuple[str, str], tuple[_Sum, _Sum]] = {}
        self.alarms: list[Alarm] = []

    def look(self, innovation: Innovation, readings: Observations, first: int) -> list[Alarm]:
        """Judge new readings.

        Args:
            innovation: Differences of these readings from their predictions.
            readings: The readings.
            first: Number of the first of these readings, from 1.
        Returns: New alarms.
        """
        mask = readings.is_measured
        row_of = torch.arange(len(readings))[:, None].expand(-1, 3)[mask]
        axis_of = torch.arange(3).expand(len(readings), 3)[mask]
        each = [(row_of == row).nonzero().flatten() for row in range(len(readings))]
        raised = []
        for row, (difference_T, covariance_T2) in enumerate(innovation.one_by_one(each)):
            of_reading = each[row]
            if not len(of_reading):
                continue
            sensor, number = self._sensors[int(readings.sensor[row])], first + row
            raised += self._improbable(difference_T, covariance_T2, sensor, number)
            for i, axis in enumerate(axis_of[of_reading].tolist()):
                value = float(difference_T[i] / covariance_T2[i, i].sqrt())
                raised += self._shifted(sensor, "xyz"[axis], number, value)
            expected_T = innovation.expected_T[row][axis_of[of_reading]]
            raised += self._along(difference_T, covariance_T2, expected_T, sensor, number)
        self.alarms += raised
        return raised

    def _improbable(
        self, difference_T: Tensor, covariance_T2: Tensor, sensor: str, number: int
    ) -> list[Alarm]:
        chi2 = float(difference_T @ torch.linalg.solve(covariance_T2, difference_T))
        if chdtrc(len(difference_T), chi2) >= IMPROBABLE:
            return []
        return [Alarm(sensor, "x, y and z together", number, number, math.sqrt(chi2))]

    def _along(
        self, difference_T: Tensor, covariance_T2: Tensor, expected_T: Tensor, sensor: str, number: int
    ) -> list[Alarm]:
        size_T = expected_T.norm()
        if float(size_T) < FIELD_SIGMA * float(covariance_T2.diagonal().max().sqrt()):
            return []
        direction = expected_T / size_T
        value = float(direction @ difference_T / (direction @ covariance_T2 @ direction).sqrt())
        return self._shifted(sensor, ALONG, number, value)

    def _shifted(self, sensor: str, what: str, number: int, value: float) -> list[Alarm]:
        raised = []
        for side in self._sums.setdefault((sensor, what), (_Sum(1.0), _Sum(-1.0))):
            if side.add(number, value):
                raised.append(Alarm(sensor, what, side.numbers[0], number, side.total / len(side.numbers)))
        return raised
