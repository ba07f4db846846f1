"""Readings that were recorded otherwise than they were measured, found one by one by what the fit of the others predicts for them.

A reading is flagged where it misses by far and one of few mistakes (`row_mistakes`) is much more probable than both its rivals: a model
that is wrong there as it is wrong at the neighbours (`local_errors`), and a wild value. The fit they are compared with is robust
(`robust_fit`). Mistakes are made in single rows and in stretches of time. Rows that follow a setting or the field are no mistakes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from estimator.diagnosis import policy
from estimator.diagnosis.expectation import Expectation, distance, predict_T
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.robust_fit import robust_fit
from estimator.diagnosis.row_mistakes import OF_ANOTHER_ROW, ROWS_BESIDE, Mistake, mistakes_of
from estimator.diagnosis.row_odds import Trial, would_show
from estimator.readings.flags import Flag, Reason
from estimator.readings.observations import Observations

MOST_ALTERNATIVES = 2  # mistakes that explain readings as well as the first does, listed beside it
FEW_NEIGHBOURS = 2  # rows that readings were exchanged with, listed one by one


class Suspects(NamedTuple):
    """Readings that were recorded otherwise than they were measured.

    Attributes:
        flags: The readings and their mistakes.
        may_be_causes: Whether a cause of the library may explain one of them: fields of one stretch that are reversed, or what lasts to
            the end of the session.
    """

    flags: list[Flag]
    may_be_causes: bool


def some_miss_by_far(fit: Fit, observations: Observations) -> bool:
    """Whether a reading is farther from what a fit predicts than errors that are alike ever are."""
    return bool(Expectation(observations, predict_T(fit, fit.values, observations)).is_far.any())


def suspects_of(fit: Fit, observations: Observations) -> Suspects:
    """Readings that a mistake explains much better than a wrong model, beside the robust fit that most readings agree with best.

    Args:
        fit: Of the rig to some of the readings.
        observations: The readings to look at, a whole session.
    """
    best, least_T = Suspects([], False), math.inf
    for start in (fit.values, fit.posterior.model.nominal):
        robust = robust_fit(fit, start, observations)
        expected = Expectation(observations, predict_T(robust, robust.values, observations))
        size_T = float(expected.size_T.median())
        if size_T < least_T:
            best, least_T = _suspects(robust, robust.values, expected), size_T
    return best


def suspects_beside(fit: Fit, values: Mapping[str, Tensor], observations: Observations) -> Suspects:
    """Such readings, each flagged for the mistake that is most probable, where values of the rig are known.

    Args:
        fit: Of the rig.
        values: Of its parameters, by the readings that do not miss by far.
        observations: The readings to look at.
    """
    return _suspects(fit, values, Expectation(observations, predict_T(fit, values, observations)))


def _suspects(fit: Fit, values: Mapping[str, Tensor], expected: Expectation) -> Suspects:
    if not bool(expected.is_far.any()):
        return Suspects([], False)
    observations, mistakes = expected.observations, mistakes_of(fit, values, expected)
    trial = Trial.of(expected, mistakes)
    is_left = torch.ones_like(expected.is_far)
    flags, may_be_causes = list[Flag](), False
    while True:
        claims = [trial.claim(number, is_left) for number in range(len(mistakes))]
        number, best = max(enumerate(claims), key=lambda claim: claim[1].log_odds)
        if best.log_odds < math.log(policy.MUCH_MORE_PROBABLE):
            return Suspects(_in_few_words(observations, flags), may_be_causes)
        mistake = best.mistake
        density = trial.by_mistake[:, best.rows].sum(dim=1)
        is_alike = trial.explained[:, best.rows].all(dim=1)
        is_alike &= density > density[number] - math.log(policy.MUCH_MORE_PROBABLE)
        alike = [mistakes[other] for other in is_alike.nonzero().flatten().tolist()]
        for sensor in observations.sensor[best.rows].unique().tolist():
            is_own = (observations.sensor == sensor) & is_left
            is_its = is_own & (best.rows | _of_the_same(best.rows & is_own, number, trial, is_own))
            is_left = is_left & ~is_its
            reason = Reason.HELD if mistake.is_exact else Reason.OTHERWISE
            readings = is_its.nonzero().flatten().tolist()
            flags.append(Flag.of(observations, reason, _words(mistake, alike), mistake.component, readings))
            is_without = would_show(mistake, expected) & (observations.sensor == sensor) & ~is_its
            may_be_causes |= _may_be_cause(mistake, observations.time_s, is_its, is_without)


def _words(mistake: Mistake, alike: Sequence[Mistake]) -> str:
    """A mistake in words, and others that explain the same readings: symmetry makes a wrong sign of a field and of a place look alike.

    Args:
        mistake: The mistake.
        alike: Those that explain these readings, itself included.
    """
    others = [other.words for other in alike if other.component in (None, mistake.component)]
    return ", or ".join(dict.fromkeys((mistake.words, *others[: MOST_ALTERNATIVES + 1])))


def _in_few_words(observations: Observations, flags: Sequence[Flag]) -> list[Flag]:
    """The flags in order; those of a sensor that hold fields of several neighbouring rows in one."""
    alone, neighbours = list[Flag](), dict[int, list[Flag]]()
    for flag in flags:
        if flag.words.startswith(OF_ANOTHER_ROW):
            neighbours.setdefault(flag.sensor, []).append(flag)
        else:
            alone.append(flag)
    for of_sensor in neighbours.values():
        if len(of_sensor) <= FEW_NEIGHBOURS:
            alone += of_sensor
            continue
        readings = sorted(reading for flag in of_sensor for reading in flag.readings)
        words = f"holds fields of other readings, up to {ROWS_BESIDE} rows away"
        alone.append(Flag.of(observations, Reason.OTHERWISE, words, None, readings))
    return sorted(alone, key=lambda flag: flag.readings)


def _may_be_cause(
    mistake: Mistake,
    time_s: Float[Tensor, " reading"],
    is_its: Bool[Tensor, " reading"],
    is_without: Bool[Tensor, " reading"],
) -> bool:
    """Whether a mistake is one that the library has: reversed for a while, or anything from an instant on.

    Args:
        mistake: The mistake.
        time_s: When each reading was taken.
        is_its: Readings that have it.
        is_without: Readings that would show it and do not.
    """
    if mistake.is_of_rows:
        return False
    later_s = time_s[is_without & (time_s >= time_s[is_its].min())]
    return not len(later_s) or (mistake.is_reversal and bool((later_s > time_s[is_its].max()).all()))


def _of_the_same(
    is_clear: Bool[Tensor, " reading"], number: int, trial: Trial, is_own: Bool[Tensor, " reading"]
) -> Bool[Tensor, " reading"]:
    """Readings that a mistake explains better than none, where it was clearly made in several others.

    It changes them too little to show alone: those that miss still, and those between two that show it. One that repeats digits was made
    where they are the same, as often as in the others, and is much more probable than a wrong model.

    Args:
        is_clear: The others.
        number: Of the mistake.
        trial: Of all mistakes.
        is_own: Readings of their sensor.
    """
    rows, mistake, expected = is_clear.nonzero().flatten(), trial.mistakes[number], trial.expected
    if len(rows) < policy.FEWEST_OF_ONE_MISTAKE:
        return torch.zeros_like(is_clear)
    measured_T = expected.observations.field_sensor_T
    if mistake.is_exact:
        log_rate = math.log(len(rows) / int(is_own.sum()))
        is_likely = trial.by_mistake[number] - trial.by_model + log_rate > math.log(policy.MUCH_MORE_PROBABLE)
        return is_likely & (measured_T == mistake.expected_T)[:, mistake.component]
    by_mistake = distance(measured_T, mistake.expected_T, expected.size_T)
    is_between = torch.zeros_like(is_clear)
    for before, after in pairwise(rows.tolist()):
        if after - before <= ROWS_BESIDE:
            is_between[before:after] = True
    is_better = (by_mistake < expected.misses - policy.BETTER_BY) & (
        by_mistake < mistake.magnifies * policy.NEAR_TO_EXPECTED
    )
    is_better &= ~mistake.expected_T.isnan().any(dim=1)
    return is_better & (is_between | (expected.misses > policy.NEAR_TO_EXPECTED))
