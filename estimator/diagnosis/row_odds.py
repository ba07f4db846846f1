"""How much more probable a mistake of rows is than a wrong model or a wild value, and whether its rows follow a setting or the field."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from estimator.diagnosis import policy
from estimator.diagnosis.expectation import Expectation, distance
from estimator.diagnosis.local_errors import log_density_of_wrong_model
from estimator.diagnosis.row_mistakes import Mistake
from estimator.readings.digits import step_of
from estimator.readings.flags import in_time
from estimator.readings.observations import Observations

LEAST_STEP = 1e-3  # of the size of errors, where readings have no last digit


class Claim(NamedTuple):
    """Rows that a mistake explains much better than its rivals.

    Attributes:
        mistake: The mistake.
        rows: The readings.
        log_odds: Logarithm of how many times more probable it is in all of them together; minus infinity where there are none.
    """

    mistake: Mistake
    rows: Bool[Tensor, " reading"]
    log_odds: float


@dataclass(frozen=True)
class Trial:
    """Readings and the mistakes that may have been made in them.

    Attributes:
        expected: Of the readings.
        mistakes: All that are considered.
        explained: Readings that miss by far which each of them makes fit, of those that it would change by far.
        shown: Readings that each would change by far.
        by_mistake: Log density of each reading's field where each of them was made.
        by_model: The same where the model is wrong.
        by_chance: The same where some of its components are wild.
    """

    expected: Expectation
    mistakes: Sequence[Mistake]
    explained: Bool[Tensor, "mistake reading"]
    shown: Bool[Tensor, "mistake reading"]
    by_mistake: Float[Tensor, "mistake reading"]
    by_model: Float[Tensor, " reading"]
    by_chance: Float[Tensor, " reading"]

    @classmethod
    def of(cls, expected: Expectation, mistakes: Sequence[Mistake]) -> Trial:
        """The densities of readings that miss by far.

        Args:
            expected: Of the readings.
            mistakes: At least one.
        """
        shown = torch.stack([would_show(mistake, expected, mistake.magnifies) for mistake in mistakes])
        fits = torch.stack([_fits(mistake, expected) for mistake in mistakes])
        by_mistake = torch.stack([_log_density(mistake, expected) for mistake in mistakes])
        return cls(
            expected,
            mistakes,
            expected.is_far & fits & shown,
            shown,
            by_mistake,
            log_density_of_wrong_model(expected),
            _log_density_by_chance(expected),
        )

    def claim(self, number: int, is_left: Bool[Tensor, " reading"]) -> Claim:
        """What a mistake explains of the readings that no other explains.

        Args:
            number: Of the mistake.
            is_left: Those readings.
        """
        mistake, observations = self.mistakes[number], self.expected.observations
        rows, log_odds = torch.zeros_like(is_left), -math.log(len(self.mistakes))
        explained = self.explained[number] & is_left
        for sensor in observations.sensor[explained].unique().tolist():
            own = in_time(observations, sensor)
            own = own[is_left[own]]
            rates = self._rates(own, explained[own])
            own = own[self.shown[number][own]]
            stretch, log_odds_of_stretch = self._stretches(number, own, explained[own], rates)
            is_clear = log_odds_of_stretch > math.log(policy.MUCH_MORE_PROBABLE)
            chosen = explained[own] & is_clear[stretch]
            if bool(chosen.any()) and (mistake.follows_field or not self._follow(mistake, own, chosen)):
                rows[own[chosen]] = True
                log_odds += float(log_odds_of_stretch[stretch[chosen].unique()].sum())
        return Claim(mistake, rows, log_odds if bool(rows.any()) else -math.inf)

    def _rates(self, own: Int[Tensor, " own"], explained: Bool[Tensor, " own"]) -> tuple[float, float]:
        """Shares of a sensor's readings with this mistake and of those that miss by far otherwise."""
        n_far, n_explained = int(self.expected.is_far[own].sum()), int(explained.sum())
        return (n_explained + 0.5) / (len(own) + 1.0), (n_far - n_explained + 0.5) / (len(own) + 1.0)

    def _stretches(
        self,
        number: int,
        own: Int[Tensor, " own"],
        explained: Bool[Tensor, " own"],
        rates: tuple[float, float],
    ) -> tuple[Int[Tensor, " own"], Float[Tensor, " stretch"]]:
        """Number of the stretch of each reading that would show a mistake, and the log odds of the mistake in each stretch.

        A stretch begins with the chance that the mistake is made; every reading may have been wild instead.
        """
        likely, wild = rates
        rivals = torch.logaddexp(self.by_model[own], math.log(wild) + self.by_chance[own])
        stretch = torch.cat((explained.new_zeros(1), explained.diff())).long().cumsum(dim=0)
        log_odds = rivals.new_full((int(stretch[-1]) + 1,), math.log(likely))
        return stretch, log_odds.index_add(0, stretch, self.by_mistake[number][own] - rivals)

    def _follow(self, mistake: Mistake, own: Int[Tensor, " own"], chosen: Bool[Tensor, " own"]) -> bool:
        """Whether some of the readings are told much more briefly by a setting or the field than by time.

        The numbers of ways to choose as many readings, or the ends of as many stretches, say how long it takes to tell which they are.
        Settings and field are those that the mistake leads to where it was made, for a wrong place is an uncommon one.
        """
        recorded = self.expected.observations
        columns = _columns(recorded, self.expected.predicted_T)[own]
        if mistake.real is not None:
            columns = torch.where(chosen[:, None], _columns(mistake.real, mistake.expected_T)[own], columns)
        return follow_a_column(columns, chosen)


def follow_a_column(columns: Float[Tensor, "own column"], chosen: Bool[Tensor, " own"]) -> bool:
    """Whether a setting or the field tells much more briefly than time which readings of a sensor are chosen.

    Args:
        columns: Settings and field, of the readings in order of time.
        chosen: Those of them.
    """
    n = len(chosen)
    columns = columns[:, columns.min(dim=0).values < columns.max(dim=0).values]
    by_time = min(_log_ways(n, int(chosen.sum())), _log_ways(n, 2 * n_runs(chosen)))
    # More ends than half the readings are as briefly told as few, but then the chosen ones lie between all others.
    ends = (min(2 * n_runs(chosen[column.argsort(stable=True)]), n // 2) for column in columns.T)
    by_column = [_log_ways(n, number) for number in ends]
    if not by_column:
        return False
    return min(by_column) + math.log(len(by_column) * policy.MUCH_MORE_PROBABLE) < by_time


def would_show(mistake: Mistake, expected: Expectation, magnified: float = 1.0) -> Bool[Tensor, " reading"]:
    """Readings that a mistake would change by far in what was measured, with errors that are magnified."""
    predicted_T = expected.predicted_T.masked_fill(~expected.observations.is_measured, torch.nan)
    off = distance(predicted_T, mistake.expected_T, magnified * expected.size_T)
    return off > policy.FAR_FROM_EXPECTED


def _fits(mistake: Mistake, expected: Expectation) -> Bool[Tensor, " reading"]:
    """Readings that are as a mistake would have them."""
    measured_T = expected.observations.field_sensor_T
    off = distance(measured_T, mistake.expected_T, mistake.magnifies * expected.size_T)
    fits = off < policy.NEAR_TO_EXPECTED
    if mistake.is_exact:
        fits &= (measured_T == mistake.expected_T)[:, mistake.component]
    return fits


def _log_density(mistake: Mistake, expected: Expectation) -> Float[Tensor, " reading"]:
    """Log density of the readings per T of every measured component, where a mistake was made in them."""
    measured_T = expected.observations.field_sensor_T
    sizes_T = expected.size_T[:, None].repeat(1, 3)
    components = slice(None) if mistake.component is None else mistake.component
    sizes_T[:, components] *= mistake.magnifies
    density = _of_errors(measured_T - mistake.expected_T, sizes_T)
    if mistake.is_anywhere:
        density = -expected.range_T.log()[:, None].expand(-1, 3)
    if mistake.is_exact:
        for sensor in expected.observations.sensor.unique().tolist():
            own = expected.observations.sensor == sensor
            step_T = step_of(measured_T[own, mistake.component].cpu().numpy())
            least_T = (LEAST_STEP * expected.size_T[own]).clamp(min=step_T)
            density[own, mistake.component] = -least_T.log()
    return torch.where(measured_T.isnan(), 0.0, density).sum(dim=1) - mistake.log_choices


def _log_density_by_chance(expected: Expectation) -> Float[Tensor, " reading"]:
    """Log density of the readings where each component may be anything that its sensor reads."""
    measured_T = expected.observations.field_sensor_T
    density = _of_errors(measured_T - expected.predicted_T, expected.size_T[:, None].expand(-1, 3))
    density = torch.logaddexp(density, -expected.range_T.log()[:, None])
    return torch.where(measured_T.isnan(), 0.0, density).sum(dim=1)


def _of_errors(
    error_T: Float[Tensor, "reading 3"], size_T: Float[Tensor, "reading 3"]
) -> Float[Tensor, "reading 3"]:
    errors = torch.distributions.StudentT(policy.DEGREES_OF_ERRORS, 0.0, size_T, validate_args=False)
    return errors.log_prob(error_T.nan_to_num(0.0))


def _columns(readings: Observations, field_T: Float[Tensor, "reading 3"]) -> Float[Tensor, "reading column"]:
    """Currents, poses and the field."""
    columns = readings.current_A, *readings.motion.values(), field_T, field_T.norm(dim=1, keepdim=True)
    return torch.cat(columns, dim=1)


def n_runs(chosen: Bool[Tensor, " own"]) -> int:
    """Number of unbroken stretches of those that are chosen."""
    return int(chosen[:1].sum()) + int((chosen[1:] & ~chosen[:-1]).sum())


def _log_ways(n: int, k: int) -> float:
    """Logarithm of the number of ways to choose k of n; infinite where there are fewer than k."""
    if k > n:
        return math.inf
    return math.lgamma(n + 1) - math.lgamma(k + 1) - math.lgamma(n - k + 1)
