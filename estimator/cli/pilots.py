"""What chooses the stops of a session while it is measured: the autopilot of goals, or the recheck of a calibration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from estimator.acquisition.pace import Pace
from estimator.calibration.result import Calibration
from estimator.planning.autopilot import pilot_of
from estimator.planning.decision import Limits
from estimator.planning.pilot import Pilot
from estimator.readings.observations import Observations
from estimator.recalibration.recheck import Recheck
from estimator.recalibration.sequential import Rates
from estimator.rig.rig import Rig


@runtime_checkable
class Question(Protocol):
    """What a session shall answer whose stops are chosen while it is measured."""

    def pilot(self, rig: Rig, candidates: Observations, pace: Pace, seed: int) -> Pilot:
        """What chooses among candidates."""


@dataclass(frozen=True)
class Until:
    """Goals of a session whose stops are chosen while it is measured.

    Attributes:
        goals: As the user wrote them.
        ends: Limits of stops and time.
    """

    goals: tuple[str, ...]
    ends: Limits

    def pilot(self, rig: Rig, candidates: Observations, pace: Pace, seed: int) -> Pilot:
        """What chooses among candidates."""
        return pilot_of(rig, candidates, self.goals, pace, self.ends, seed)


@dataclass(frozen=True)
class StillHolds:
    """The question whether a calibration still holds.

    Attributes:
        calibration: The one in use.
        share: Of the field, that a change is.
        ends: Limits of stops and time.
    """

    calibration: Calibration
    share: float
    ends: Limits

    def pilot(self, rig: Rig, candidates: Observations, pace: Pace, seed: int) -> Pilot:
        """What chooses among candidates."""
        return Recheck(self.calibration, candidates, self.share, pace, self.ends, Rates())
