"""A proposed measurement: the visits of a design, with those that are held out, again and without current, in order."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import networkx as nx
import numpy as np
import torch
from torch import Tensor

from estimator.acquisition.pace import Pace, durations_s, ways_between_s
from estimator.planning.candidates import one_row_each
from estimator.planning.design import Design
from estimator.planning.goals import Goal, ParametersGoal
from estimator.planning.information import known_coordinates
from estimator.readings.metrics import HALF_WIDTH_90
from estimator.readings.observations import Observations
from estimator.readings.plan import plan_text
from estimator.rig.rig import Rig

MOST_MATCHED = 150  # stops up to which Christofides' algorithm takes less than a second; the greedy tour is a tenth longer
LEARNT = 0.5  # of the prior's width: what the readings teach is worth a free parameter


@dataclass(frozen=True)
class Planned:
    """A proposed measurement.

    Attributes:
        goals: As they were given; none asks for all free parameters together.
        stops: In the order of the visit, one row each.
        reasons: Why each is there.
        expected: For each goal, half-width of the 90 % interval over its target after each stop; 1 is just reached. Medians over draws of
            the prior.
        times_s: Expected duration of each stop, without the way to the first one.
        random_duration_s: Of the whole measurement in random order.
        unknown: Free parameters that it leaves with more than half of their prior's width, and the share that they keep.
        text: The plan file.
        not_told: What no laboratory is without and the rig does not mention, which the currents of the stops cannot tell from the fields
            of the coils: the expected half-widths hold only where it is not there.
    """

    goals: tuple[str, ...]
    stops: Observations
    reasons: tuple[str, ...]
    expected: tuple[tuple[float, ...], ...]
    times_s: tuple[float, ...]
    random_duration_s: float
    unknown: Mapping[str, float]
    text: str
    not_told: tuple[str, ...] = ()

    @property
    def duration_s(self) -> float:
        """Expected duration of the whole measurement, without the way to the first stop."""
        return sum(self.times_s)

    @property
    def n_needed(self) -> int | None:
        """Stops after which all goals are expected to be reached; None where they are not."""
        worst = [max(widths) for widths in zip(*self.expected, strict=True)]
        return next((n for n, width in enumerate(worst, start=1) if width <= 1.0), None)

    def to_json(self) -> dict[str, Any]:
        """All but the stops, which the plan file lists."""
        return {
            "goals": list(self.goals),
            "stops": len(self.stops),
            "validation": int(self.stops.is_validation.sum()),
            "needed": self.n_needed,
            "expected": [list(widths) for widths in self.expected],
            "duration_s": self.duration_s,
            "random_duration_s": self.random_duration_s,
            "unknown": dict(self.unknown),
            "not_told": list(self.not_told),
        }


class Visits:
    """The visits of a design, and what they are expected to bring.

    Args:
        design: Stops that inform.
        stops: Candidates, a row for each sensor.
        goals: What shall be known.
        rig: As it is fitted.
        pace: Speeds and times.
        seed: Of all random orders.
    """

    def __init__(
        self, design: Design, stops: Observations, goals: Sequence[Goal], rig: Rig, pace: Pace, seed: int
    ) -> None:
        self.design, self.goals, self.rig, self.pace, self.seed = design, goals, rig, pace, seed
        self.stops = one_row_each(stops, rig)
        self.generator = torch.Generator().manual_seed(seed)
        self.key = torch.cat([self.stops.current_A, *self.stops.motion.values()], dim=1)

    @property
    def n_settings_off(self) -> int:
        """Number of candidates without current."""
        return int((~self.stops.current_A.any(-1)).sum())

    def planned(self, order: str, n_validation: int, n_zero: int, n_again: int) -> Planned:
        """All visits in order, as a plan.

        Args:
            order: `tour` or `random`.
            n_validation, n_zero, n_again: Numbers of stops that are held out, without current, and visited again.
        """
        with_signs = self._both_signs()
        held_out = self._held_out(n_validation, set(with_signs))
        without = self._without_current(n_zero)
        there = [*with_signs, *held_out, *without]
        reasons = [*self._gains(), *["held out: judges the fit, which does not see it"] * len(held_out)]
        reasons += ["no current: shows fields that are not of the coils"] * len(without)
        distinct = list(dict.fromkeys(there))
        way = tour(self.stops.rows(torch.tensor(distinct)).alone, self.rig, self.pace)
        place = {distinct[i]: position for position, i in enumerate(way)}
        visits = sorted(range(len(there)), key=lambda i: place[there[i]])
        back = self._again(list(dict.fromkeys(there[i] for i in visits if i < len(with_signs))), n_again)
        rows = [there[i] for i in visits] + back
        why = [reasons[i] for i in visits]
        why += ["again, from the other side: shows backlash and drift"] * len(back)
        is_validation = torch.tensor([there[i] in held_out for i in visits] + [False] * len(back))
        if order == "random":
            shuffled = torch.randperm(len(rows), generator=self.generator)
            rows, why = [rows[i] for i in shuffled], [why[i] for i in shuffled]
            is_validation = is_validation[shuffled]
        return self._result(torch.tensor(rows), why, is_validation)

    def _both_signs(self) -> list[int]:
        """The chosen stops, every second visit with the opposite current where that is a candidate."""
        n_coils = self.stops.current_A.shape[1]
        rows = []
        for number, row in enumerate(sorted(self.design.chosen)):
            flipped = self.key[row].clone()
            flipped[:n_coils] *= -1.0
            same = (self.key == flipped).all(-1).nonzero().flatten()
            rows.append(int(same[0]) if number % 2 and len(same) else row)
        return rows

    def _held_out(self, n: int, taken: set[int]) -> list[int]:
        """Stops by chance at the largest currents, none of them among those of the fit."""
        strength = self.stops.current_A.abs().sum(-1)
        order = torch.randperm(len(self.stops), generator=self.generator).tolist()
        free = [
            row for row in order if row not in taken and float(strength[row]) >= 0.99 * float(strength.max())
        ]
        return free[:n]

    def _without_current(self, n: int) -> list[int]:
        """Stops without current at the places of chosen stops, where they are candidates."""
        is_off = ~self.stops.current_A.any(-1)
        n_coils = self.stops.current_A.shape[1]
        rows = []
        for row in dict.fromkeys(self.design.chosen):
            same = is_off & (self.key[:, n_coils:] == self.key[row, n_coils:]).all(-1)
            rows += same.nonzero().flatten().tolist()[:1]
        step = max(1, len(rows) // max(n, 1))
        return rows[::step][:n]

    def _again(self, on_the_way: list[int], n: int) -> list[int]:
        """Some stops of the fit once more, evenly along the way and in reverse."""
        step = max(1, len(on_the_way) // max(n, 1))
        return on_the_way[::-1][::step][:n]

    def _gains(self) -> list[str]:
        """What each chosen stop is worth beside all others, in the order of `_both_signs`."""
        what = "the goal" if self.goals else "the free parameters together"
        n = 1 if self.goals else self.design.precision.shape[-1]
        reasons, worth = [], {}
        for row in sorted(self.design.chosen):
            if row not in worth:
                self.design.remove(self.design.chosen.index(row))
                worth[row] = 50.0 * float(self.design.gains()[row]) / n
                self.design.add(row)
            reasons.append(f"informs: without it the intervals of {what} would be {worth[row]:.2g} % wider")
        return reasons

    def _result(self, rows: Tensor, reasons: Sequence[str], is_validation: Tensor) -> Planned:
        visited = self.stops.rows(rows).alone.with_validation(is_validation)
        expected, precision = self._curve(rows, is_validation)
        shuffled = torch.randperm(len(rows), generator=self.generator)
        times_s = tuple(durations_s(visited, self.rig, self.pace))
        random_s = sum(durations_s(visited.rows(shuffled).alone, self.rig, self.pace))
        goals = tuple(goal.text for goal in self.goals)
        text = plan_text(
            "; ".join(goals) or "all free parameters", self.rig, visited, self.pace.settle_s, reasons
        )
        unknown = self._unknown(precision)
        return Planned(goals, visited, tuple(reasons), expected, times_s, random_s, unknown, text)

    def _curve(self, rows: Tensor, is_validation: Tensor) -> tuple[tuple[tuple[float, ...], ...], Tensor]:
        """Expected widths of each goal after each stop, and the precision at the end."""
        model = self.design.expected
        precision, widths = model.precision, []
        for row, is_held_out in zip(rows, is_validation, strict=True):
            if not is_held_out:
                precision = precision + model.information(row[None])
            widths.append(model.widths(precision).median(-1).values)
        return tuple(tuple(each) for each in torch.stack(widths).T.tolist()), precision

    def _unknown(self, precision: Tensor) -> dict[str, float]:
        """Free parameters that keep more than half of their prior's width, and the share that they keep."""
        model = self.design.expected
        sds = {p.name: p.prior.sd for p in self.rig.free if p.prior and not p.name.endswith(".noise_T")}
        widths = {name: sd * HALF_WIDTH_90 for name, sd in sds.items() if math.isfinite(sd)}
        known = known_coordinates(model.coordinates)
        rows = ParametersGoal("", widths).rows(model.coordinates, model.at)[..., known]
        share = ((rows @ torch.linalg.inv(precision)) * rows).sum(-1).sqrt().median(0).values
        return {name: value for name, value in zip(widths, share.tolist(), strict=True) if value > LEARNT}


def tour(stops: Observations, rig: Rig, pace: Pace) -> list[int]:
    """Numbers of stops in the order of a short way through all of them.

    Args:
        stops: One row each.
        rig: Names movers and coils.
        pace: Speeds of the arms and ramp rates of the supplies.

    References: Christofides, Report 388, Carnegie Mellon University (1976): at most 1.5 times the shortest tour.
    """
    n = len(stops)
    if n < 4:
        return list(range(n))
    rows = torch.arange(n)
    ways_s = ways_between_s(stops, rig, pace, rows[:, None], rows).numpy()
    graph = nx.from_numpy_array(ways_s + 1e-6 * (1.0 - np.eye(n)))  # a way of no length would be no edge
    solve = nx.approximation.christofides if n <= MOST_MATCHED else nx.approximation.greedy_tsp
    around: list[int] = solve(graph)[:-1]
    lengths_s = ways_s[around, np.roll(around, -1)]
    longest = int(lengths_s.argmax()) + 1  # no arm has to close the tour
    return around[longest:] + around[:longest]
