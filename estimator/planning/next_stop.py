"""The next stop for a rig that other programs drive, from its readings alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from estimator.acquisition.pace import Pace, default_pace
from estimator.planning.autopilot import pilot_of
from estimator.planning.candidates import clear_candidates
from estimator.planning.decision import Decision, Limits
from estimator.readings.observations import Observations
from estimator.readings.plan import Plan
from estimator.rig.rig import Rig
from estimator.store.growing import entries_of


@dataclass(frozen=True)
class NextStop:
    """What to measure next.

    Attributes:
        decision: Why, and how far the goals are; its `row` is None where the session shall end.
        current_A: Current of each coil.
        motion: The six numbers of each mover's columns, in SI.
        is_validation: Whether the readings shall be held out of the fit.
    """

    decision: Decision
    current_A: Mapping[str, float]
    motion: Mapping[str, Sequence[float]]
    is_validation: bool


class Adviser:
    """Says what to measure next; it follows a session stop by stop.

    Args:
        rig: As described.
        places: Poses and currents to choose from.
        goals: What shall be known, as in `estimator.planning.plan.plan`.
        pace: Speeds and times; arms at 100 mm/s by default.
        most_stops: Number of stops after which to end in any case.
        seed: Of all random choices; the same readings and seed give the same stop.
    Raises:
        InvalidInput: A goal cannot be read, or is out of reach.
    """

    def __init__(
        self, rig: Rig, places: Plan, goals: Sequence[str], pace: Pace | None, most_stops: int, seed: int
    ) -> None:
        pace = pace or default_pace(rig, places.settle_s)
        self.rig = rig
        self.pilot = pilot_of(rig, clear_candidates(places, rig, seed), goals, pace, Limits(most_stops), seed)

    def after(self, entries: Sequence[Mapping[str, Any]]) -> NextStop:
        """The next stop after those of a journal.

        Args:
            entries: As `estimator.store.growing` has them.
        """
        decision = self.pilot.decide(entries)
        if decision.row is None:
            return NextStop(decision, {}, {}, False)
        settings, row = self.pilot.settings, decision.row
        currents_A = dict(
            zip([c.name for c in self.rig.coils], settings.current_A[row].tolist(), strict=True)
        )
        motion = {name: columns[row].tolist() for name, columns in settings.motion.items()}
        return NextStop(decision, currents_A, motion, decision.is_validation)


def next_stop(
    rig: Rig,
    places: Plan,
    goals: Sequence[str],
    readings: Observations | None = None,
    *,
    pace: Pace | None = None,
    most_stops: int = 200,
    seed: int = 0,
) -> NextStop:
    """The next stop for a rig that other programs drive, given the readings so far.

    Args:
        rig: As described.
        places: Poses and currents to choose from.
        goals: What shall be known, as in `estimator.planning.plan.plan`.
        readings: All readings so far, held-out ones marked so; None before the first.
        pace: Speeds and times; arms at 100 mm/s by default.
        most_stops: Number of stops after which to end in any case.
        seed: Of all random choices; the same readings and seed give the same stop.
    Raises:
        InvalidInput: A goal cannot be read, or is out of reach.

    Examples:
        >>> from estimator import load_plan, load_rig, next_stop
        >>> rig = load_rig("configs/paper_simulation.yaml")
        >>> places = load_plan("configs/plans/paper_grid.yaml", rig)
        >>> stop = next_stop(rig, places, ["field 1 % in box x_mm=-50:50 y_mm=-50:50 z_mm=-25:25"])
        >>> stop.decision.reason, stop.current_A
        ('informs: greatest expected gain by second', {'coil1': 3.0})
    """
    adviser = Adviser(rig, places, goals, pace, most_stops, seed)
    return adviser.after([] if readings is None else entries_of(readings, rig))
