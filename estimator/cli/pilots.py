"""What chooses the stops of a session while it is measured: the autopilot of goals, or the recheck of a calibration."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeAlias

from estimator.acquisition.pace import Pace
from estimator.calibration.result import Calibration
from estimator.planning.autopilot import pilot_of
from estimator.planning.decision import Limits
from estimator.planning.pilot import Pilot
from estimator.readings.observations import Observations
from estimator.recalibration.recheck import Recheck
from estimator.recalibration.sequential import Rates
from estimator.rig.rig import Rig

Question: TypeAlias = Callable[[Rig, Observations, Pace, int], Pilot]
"""What a session shall answer whose stops are chosen: who chooses among candidates of a rig, at a pace, with a seed."""


def until(goals: Sequence[str], ends: Limits) -> Question:
    """Goals to be reached, as the user wrote them, and limits of stops and time."""
    return lambda rig, candidates, pace, seed: pilot_of(rig, candidates, goals, pace, ends, seed)


def still_holds(calibration: Calibration, share: float, ends: Limits) -> Question:
    """The question whether the calibration in use still holds: whether the field has changed by a share."""
    return lambda _rig, candidates, pace, _seed: Recheck(calibration, candidates, share, pace, ends, Rates())
