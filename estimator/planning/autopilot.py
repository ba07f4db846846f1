"""Stops chosen while a session is measured: each decided from what is on disk alone, until a goal is reached or cannot be."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from torch import Tensor

from estimator.acquisition.pace import Pace
from estimator.planning.candidates import fitted_rig, largest_currents_A
from estimator.planning.choosing import Chooser, Pilot
from estimator.planning.decision import Decision, Limits, elapsed_s, refused_before
from estimator.planning.goals import Goal, goal_of
from estimator.planning.information import refuse_unreachable
from estimator.planning.judgement import Judged, judge
from estimator.planning.so_far import SoFar
from estimator.readings.observations import Observations
from estimator.rig.rig import Rig

FEWEST_HELD_OUT, FEWEST_AGAIN = 4, 3  # before a goal counts as reached
CERTAIN_SD = 3.5  # from which on more stops would not help; it is asked after every stop
FLOOR_GAIN = 0.9  # where four times the stops leave more than that of an interval, a floor is reached


class Autopilot(Pilot):
    """Chooses the next stop of a session.

    Args:
        rig: As it is fitted.
        stops: Candidates, a row for each sensor.
        goals: What shall be known.
        pace: Speeds and times.
        limits: Ends of the session beside its goals.
        seed: Of the draws, and of the stops that are held out.
    """

    def __init__(
        self, rig: Rig, stops: Observations, goals: Sequence[Goal], pace: Pace, limits: Limits, seed: int
    ) -> None:
        self.rig, self.stops, self.goals, self.limits = rig, stops, goals, limits
        self.so_far = SoFar(rig, stops, goals, limits.most_stops, seed)
        self.chooser = Chooser(rig, self.settings, pace, seed)

    @property
    def settings(self) -> Observations:
        """The candidates, one row each."""
        return self.so_far.settings

    @property
    def rows(self) -> list[int]:
        """Candidates that were visited before the last decision, in order."""
        return self.so_far.rows

    @property
    def header(self) -> dict[str, Any]:
        """Goals and limits of a session, from its journal."""
        return {"goals": [goal.text for goal in self.goals], "limits": asdict(self.limits)}

    def estimate(self) -> dict[str, Tensor]:
        """Every number of the rig at the estimate."""
        fit = self.so_far.fit
        return fit.coordinates.values(fit.vector)

    def refuse_unreachable(self) -> None:
        """Refuse goals that no number of the candidates reaches, before anything moves."""
        refuse_unreachable(self.so_far.model.alone, self.goals)

    def decide(self, entries: Sequence[Mapping[str, Any]], refused: Sequence[int] = ()) -> Decision:
        """The decision after the stops of a journal."""
        self.so_far.follow(entries)
        left_out = refused_before(entries) | set(refused)
        judged, rows = judge(self.so_far), self.so_far.rows
        is_reached = judged.is_reached and bool(rows)
        is_judged = judged.misfit.n_held_out >= FEWEST_HELD_OUT
        end = self._end(entries, judged)
        if not end and len(left_out) == len(self.settings):
            end = f"no stop is left: instruments refused all {len(left_out)}"
        is_again = is_reached and is_judged
        row, reason, gain = (
            (None, end, 0.0) if end else self.chooser.next(rows, judged, is_reached, is_again, left_out)
        )
        return Decision(
            row,
            reason,
            tuple(judged.widths.tolist()),
            judged.misfit.rest_T,
            gain,
            len(self.settings),
            self._left(len(entries), judged),
            judged.cause,
            judged.stated,
            tuple(sorted(left_out)),
        )

    def _end(self, entries: Sequence[Mapping[str, Any]], judged: Judged) -> str:
        """Why the session shall end; empty where it shall go on."""
        n, worst, misfit = len(entries), float(judged.widths.max()), judged.misfit
        is_judged = misfit.n_held_out >= FEWEST_HELD_OUT and misfit.n_again >= FEWEST_AGAIN
        if n and judged.is_reached and is_judged:
            stated = f"; these places cannot test {', '.join(judged.stated)}" if judged.stated else ""
            return f"goal reached, also by {misfit.n_held_out} held-out stops{stated}"
        so_far = f"{worst:.2g} times the wanted half-width is left"
        if n >= self.limits.most_stops:
            return f"limit of {n} stops; {so_far}"
        longest_s = self.limits.longest_s
        if longest_s is not None and n and elapsed_s(entries) * (n + 1) / n > longest_s:
            return f"limit of {longest_s / 60.0:.3g} minutes; {so_far}"
        is_certain = misfit.rest_T == 0.0 or misfit.distance_sd > CERTAIN_SD
        is_large = self.so_far.n_fitted > 2 * judged.n_unknown
        is_certain &= judged.split is None
        if is_judged and is_certain and is_large and float(judged.later.max()) > FLOOR_GAIN * worst:
            rest = f" by {1e6 * misfit.rest_T:.3g} µT" if misfit.rest_T else ""
            like = f", as for example {judged.cause} would" if judged.is_sure else ""
            why = (
                f"readings contradict the model{rest}{like}"
                if rest or like
                else "these places do not see the rest"
            )
            return f"floor reached: {why}; {so_far}"
        return ""

    def _left(self, n: int, judged: Judged) -> int:
        """Stops that are expected to be still needed, as intervals shrink with the root of their number."""
        needed = max(n, self.so_far.fit.coordinates.n) * max(float(judged.widths.max()), 1.0) ** 2
        return int(min(self.limits.most_stops, needed)) - n


def pilot_of(
    rig: Rig, stops: Observations, goals: Sequence[str], pace: Pace, limits: Limits, seed: int
) -> Autopilot:
    """An autopilot for goals as a user writes them.

    Args:
        rig: As described.
        stops, pace, limits, seed: As for `Autopilot`.
        goals: Such as `field 0.2 % in box x_mm=-50:50 y_mm=-50:50 z_mm=-25:25`.
    Raises:
        InvalidInput: A goal cannot be read, or is out of reach.
    """
    rig, largest_A = fitted_rig(rig, stops, goals), largest_currents_A(rig, stops)
    pilot = Autopilot(rig, stops, [goal_of(text, rig, largest_A) for text in goals], pace, limits, seed)
    pilot.refuse_unreachable()
    return pilot
