"""Stops chosen while a session is measured: each decided from what is on disk alone, until a goal is reached or cannot be.

The linearised model is renewed whenever the session has grown by a third. What the readings contradict counts as an error that more
readings do not lessen (`estimator.planning.judgement`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.acquisition.acquire import Choice
from estimator.acquisition.pace import Pace, ways_between_s
from estimator.inference.running import RunningFit
from estimator.model.measurement_model import MeasurementModel
from estimator.planning.candidates import fitted_rig, largest_currents_A, one_row_each
from estimator.planning.decision import Decision, Limits, elapsed_s
from estimator.planning.goals import Goal, goal_of
from estimator.planning.information import (
    Design,
    Expected,
    draws_of_prior,
    known_coordinates,
    refuse_unreachable,
    widths_of,
)
from estimator.planning.judgement import CERTAIN_SD, Misfit, misfit_of
from estimator.readings.observations import Observations
from estimator.rig.rig import Rig
from estimator.store.growing import observations_of

N_DRAWS = (
    4  # of the running posterior, or of the prior before the first reading; 8 choose stops that are as good
)
GROWTH = 1.3  # of the session, until the model is linearised again
EVERY, HELD_OUT, AGAIN = (
    8,
    7,
    3,
)  # of eight stops the last one is held out, and the fourth one is visited again
OFF_EVERY, OFF = 20, 10  # of twenty stops one is without current
FEWEST_HELD_OUT, FEWEST_AGAIN = 4, 3  # before a goal counts as reached
HELD_OUT_WORDS = "held out"
FLOOR_GROWTH, FLOOR_GAIN = (
    4.0,
    0.9,
)  # where four times the stops leave more than 0.9 of an interval, a floor is reached


class Autopilot:
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
        self.rig, self.stops, self.goals = rig, stops, goals
        self.pace, self.limits, self.seed = pace, limits, seed
        self.settings = one_row_each(stops, rig)
        self.rules = MeasurementModel.build(self.rig, stops).rules
        self.strength = self.settings.current_A.abs().sum(-1)
        self._restart()

    @property
    def header(self) -> dict[str, Any]:
        """What the journal of a session says of its goals and limits."""
        return {"goals": [goal.text for goal in self.goals], "limits": asdict(self.limits)}

    def estimate(self) -> dict[str, Tensor]:
        """Every number of the rig at the estimate."""
        return self._fit.coordinates.values(self._fit.vector)

    def refuse_unreachable(self) -> None:
        """Refuse goals that no number of the candidates reaches, before anything moves."""
        refuse_unreachable(self._expected, self.goals)

    def _restart(self) -> None:
        self._fit = RunningFit(self.rig)
        self._entries: list[Mapping[str, Any]] = []
        self._fitted: Observations | None = None
        self._known = known_coordinates(self._fit.coordinates)
        self._n_linearised = 0
        self._expected = self._linearised(draws_of_prior(self.rig, N_DRAWS, self.seed))

    def choose(self, entries: Sequence[Mapping[str, Any]]) -> Choice | None:
        """The next stop after those of a journal, with its decision as a record; None where the session shall end."""
        decision = self.decide(entries)
        if decision.row is None:
            return None
        before = [self._row(entry) for entry in entries]
        this_s = float(self._next_s(before)[decision.row])
        mean_s = elapsed_s(entries) / len(entries) if entries else this_s
        is_validation = decision.reason.startswith(HELD_OUT_WORDS)
        return Choice(
            decision.row,
            is_validation,
            before.count(decision.row),
            this_s,
            mean_s * max(0, decision.left - 1),
            {"decision": decision.to_json()},
        )

    def decide(self, entries: Sequence[Mapping[str, Any]]) -> Decision:
        """The decision after the stops of a journal; the same entries always give the same one."""
        self._follow(entries)
        rows = [self._row(entry) for entry in entries]
        precision = self._fit.precision[self._known][:, self._known]
        misfit = self._misfit(rows, precision)
        widths = self._widths(self._expected.wanted, precision, misfit)
        if bool((widths <= 1.0).all()) and len(entries):
            at = self._fit.vector[None]
            here = [goal.rows(self._fit.coordinates, at)[..., self._known] for goal in self.goals]
            widths = self._widths(here, precision, misfit)
        is_reached = bool((widths <= 1.0).all())
        row, reason, gain = self._next(rows, is_reached, misfit, precision)
        end = self._end(entries, widths, is_reached, misfit, precision)
        left = self._left(len(entries), float(widths.max()))
        numbers = tuple(widths.tolist()), misfit.rest_T, gain, len(self.settings), left
        return Decision(None, end, *numbers) if end else Decision(row, reason, *numbers)

    def _row(self, entry: Mapping[str, Any]) -> int:
        """Number of the candidate of a stop: as it was chosen, else the nearest one."""
        if "decision" in entry:
            return int(entry["decision"]["row"])
        here = [*entry["current_A"], *(x for m in self.rig.movers for x in entry["motion"][m.name])]
        columns = torch.cat([self.settings.current_A, *self.settings.motion.values()], dim=1)
        width = (columns.amax(0) - columns.amin(0)).clamp(min=1e-12)
        return int(((columns - columns.new_tensor(here)) / width).norm(dim=-1).argmin())

    def _follow(self, entries: Sequence[Mapping[str, Any]]) -> None:
        """Add what the fit does not hold yet, stop by stop, so that an interrupted session goes the same way."""
        if list(entries[: len(self._entries)]) != self._entries:
            self._restart()
        for entry in entries[len(self._entries) :]:
            self._entries.append(entry)
            readings = observations_of([entry], self.rig)
            usable = ~readings.is_validation & readings.is_measured.any(-1)
            if bool(usable.any()):
                new = readings.rows(usable)
                self._fitted = new.alone if self._fitted is None else self._fitted.followed_by(new)
                self._fit.update(self._fitted, len(new))
                while self._fit.can_polish:
                    self._fit.polish(self._fitted)
            if len(self._entries) >= GROWTH * self._n_linearised:
                self._n_linearised = len(self._entries)
                self._expected = self._linearised(self._draws())

    def _draws(self) -> Float[Tensor, "draw all"]:
        """The estimate, and draws of its normal approximation that the prior allows."""
        fit, generator = self._fit, torch.Generator().manual_seed(self.seed)
        root = torch.linalg.cholesky(fit.covariance)
        normal = torch.randn(4 * N_DRAWS, len(root), dtype=torch.float64, generator=generator)
        drawn = fit.vector + normal @ root.mT
        possible = drawn[torch.isfinite(fit.coordinates.log_prior(drawn))]
        return torch.cat((fit.vector[None], possible))[:N_DRAWS]

    def _linearised(self, at: Float[Tensor, "draw all"]) -> Expected:
        return Expected.of(self.rig, self.stops, self.goals, at, self.rules)

    def _misfit(self, rows: Sequence[int], precision: Tensor) -> Misfit:
        held_out = observations_of([e for e in self._entries if e["is_validation"]], self.rig)
        if self._fitted is None:
            return Misfit(0.0, math.nan, len(held_out), 0)
        fields_T = [observations_of([entry], self.rig).field_sensor_T for entry in self._entries]
        n_followed = self._n_followed(precision)
        return misfit_of(self._fit, self._fitted, held_out, self.rules, rows, fields_T, n_followed)

    def _widths(self, wanted: Sequence[Tensor], precision: Tensor, misfit: Misfit) -> Float[Tensor, " goal"]:
        """Half-widths over their targets in the median of the draws, widened by what the readings contradict."""
        widest = [goal.is_worst for goal in self.goals]
        widths = widths_of(wanted, widest, precision.expand(len(wanted[0]), -1, -1)).median(-1).values
        return widths * misfit.factor(self._n_fitted, len(precision)) * self._noise_factor(precision)

    def _noise_factor(self, precision: Tensor) -> float:
        """How much wider intervals are because the noise at the maximum is what free parameters leave of it.

        Each component adds 2 to the information on the logarithm of a noise, and its prior as much as some components would.
        """
        is_noise = torch.ones(len(self._fit.precision), dtype=torch.bool)
        is_noise[self._known] = False
        total = 0.5 * float(self._fit.precision.diagonal()[is_noise].sum())
        return 1.0 if not total else math.sqrt(total / max(total - self._n_followed(precision), 1.0))

    def _n_followed(self, precision: Tensor) -> float:
        """Numbers that the fit takes from the readings rather than from the prior."""
        prior = self._expected.precision.mean(0)
        return max(0.0, len(precision) - float(torch.trace(torch.linalg.solve(precision, prior))))

    @property
    def _n_fitted(self) -> int:
        return 0 if self._fitted is None else len(self._fitted)

    def _next(
        self, rows: Sequence[int], is_reached: bool, misfit: Misfit, precision: Tensor
    ) -> tuple[int, str, float]:
        """Number of the next candidate, why, and its gain by second."""
        n = len(rows)
        is_judged = misfit.n_held_out >= FEWEST_HELD_OUT
        is_due = (
            n % EVERY == AGAIN and misfit.n_again <= n // EVERY
        )  # the best stops are visited again anyway
        if rows and (is_due or (is_reached and is_judged)):
            return self._longest_ago(rows), "again: shows noise, drift and backlash", 0.0
        if n % EVERY == HELD_OUT or is_reached:
            return self._held_out(rows), f"{HELD_OUT_WORDS}: judges the fit, which does not see it", 0.0
        off = (~self.settings.current_A.any(-1)).nonzero().flatten()
        if n % OFF_EVERY == OFF and len(off):
            nearest = int(off[self._next_s(rows)[off].argmin()])
            return nearest, "no current: shows fields that are not of the coils", 0.0
        expected = replace(self._expected, precision=precision.expand(len(self._expected.at), -1, -1))
        by_s = Design(expected).gains() / self._next_s(rows)
        best = int(by_s.argmax())
        return best, "informs: greatest expected gain by second", float(by_s[best])

    def _next_s(self, rows: Sequence[int]) -> Float[Tensor, " stop"]:
        """Expected duration of each candidate, were it next."""
        everything = torch.arange(len(self.settings))
        here = torch.tensor(rows[-1]) if rows else everything
        ways_s = ways_between_s(self.settings, self.rig, self.pace, here, everything)
        return ways_s + self.pace.at_rest_s(self.rig)

    def _longest_ago(self, rows: Sequence[int]) -> int:
        """The stop that was visited once, and longest ago; else the one whose last visit is."""
        last = {row: place for place, row in enumerate(rows)}
        return min(last, key=lambda row: (rows.count(row), last[row]))

    def _held_out(self, rows: Sequence[int]) -> int:
        """A stop by chance at the largest currents that was not visited."""
        strong = self.strength >= 0.99 * self.strength.max()
        strong[list(set(rows))] = False
        free = strong.nonzero().flatten()
        free = free if len(free) else torch.arange(len(strong))
        generator = torch.Generator().manual_seed(self.seed + len(rows))
        return int(free[torch.randint(len(free), (), generator=generator)])

    def _end(
        self,
        entries: Sequence[Mapping[str, Any]],
        widths: Tensor,
        is_reached: bool,
        misfit: Misfit,
        precision: Tensor,
    ) -> str:
        """Why the session shall end; empty where it shall go on."""
        n, worst = len(entries), float(widths.max())
        is_judged = misfit.n_held_out >= FEWEST_HELD_OUT and misfit.n_again >= FEWEST_AGAIN
        if is_reached and is_judged:
            return f"goal reached, also by {misfit.n_held_out} held-out stops"
        so_far = f"{worst:.2g} times the wanted half-width is left"
        if n >= self.limits.most_stops:
            return f"limit of {n} stops; {so_far}"
        longest_s = self.limits.longest_s
        if longest_s is not None and n and elapsed_s(entries) * (n + 1) / n > longest_s:
            return f"limit of {longest_s / 60.0:.3g} minutes; {so_far}"
        is_certain = misfit.rest_T == 0.0 or misfit.distance_sd > CERTAIN_SD
        if is_judged and is_certain and not is_reached and self._n_fitted > 2 * len(precision):
            prior = self._expected.precision.mean(0)
            more = prior + FLOOR_GROWTH * (precision - prior)
            many = replace(misfit, n_grown=FLOOR_GROWTH)
            later = self._widths(self._expected.wanted, more, many)
            if float(later.max()) > FLOOR_GAIN * worst:
                rest = f"readings contradict the model by {1e6 * misfit.rest_T:.3g} µT"
                why = rest if misfit.rest_T else "these places do not see the rest"
                return f"floor reached: {why}; {so_far}"
        return ""

    def _left(self, n: int, width: float) -> int:
        """Stops that are expected to be still needed, as intervals shrink with the root of their number."""
        needed = max(n, self._fit.coordinates.n) * max(width, 1.0) ** 2
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
