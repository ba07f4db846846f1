"""What chooses the stops of a session while it is measured: the autopilot of goals, or the recheck of a calibration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from estimator.acquisition.acquire import Choice
from estimator.acquisition.pace import Pace
from estimator.calibration.result import Calibration
from estimator.planning.autopilot import pilot_of
from estimator.planning.decision import Limits
from estimator.readings.observations import Observations
from estimator.recalibration.recheck import Recheck
from estimator.recalibration.sequential import Rates
from estimator.rig.rig import Rig


@runtime_checkable
class Ending(Protocol):
    """Why a session ended."""

    def to_json(self) -> dict[str, Any]:
        """Its record."""


@runtime_checkable
class Pilot(Protocol):
    """Chooses the stops of a session while it is measured."""

    limits: Limits

    @property
    def header(self) -> dict[str, Any]:
        """What the journal of a session says of its question and limits."""

    def choose(self, entries: Sequence[Mapping[str, Any]], refused: Sequence[int] = ()) -> Choice | None:
        """The next stop after those of a journal; None ends the session."""

    def decide(self, entries: Sequence[Mapping[str, Any]]) -> Ending:
        """What the stops of a journal say."""


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
