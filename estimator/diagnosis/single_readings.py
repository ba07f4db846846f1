"""Readings that were recorded otherwise than they were measured, found one by one by what the fit of the others predicts for them.

A reading is flagged where it misses by far and one of few mistakes (`row_mistakes`) makes it fit. The fit they are compared with is robust
(`robust_fit`). Nothing is flagged unless those mistakes explain most of what misses by far: else it is the model that is wrong.
"""

from __future__ import annotations

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
    """Readings that a mistake explains where the model of a fit does not; none unless mistakes explain most of what misses by far.

    Args:
        fit: Of the rig to some of the readings.
        observations: The readings to look at, a whole session.
    """
    for start in (fit.values, fit.posterior.model.nominal):
        robust = robust_fit(fit, start, observations)
        suspects = suspects_beside(robust, robust.values, observations)
        if suspects.flags:
            break
    return suspects


def suspects_beside(fit: Fit, values: Mapping[str, Tensor], observations: Observations) -> Suspects:
    """Such readings, each flagged for the mistake that explains most of those left, where values of the rig are known.

    Args:
        fit: Of the rig.
        values: Of its parameters, by the readings that do not miss by far.
        observations: The readings to look at.
    """
    expected = Expectation(observations, predict_T(fit, values, observations))
    is_far = expected.is_far
    if not bool(is_far.any()):
        return Suspects([], False)
    mistakes = mistakes_of(fit, values, expected)
    explained = torch.stack([is_far & _explains(mistake, expected) for mistake in mistakes])
    left, is_flagged = is_far.clone(), torch.zeros_like(is_far)
    flags, may_be_causes = list[Flag](), False
    while bool((explained & left).any()):
        number = int((explained & left).sum(dim=1).argmax())
        mistake, is_clear = mistakes[number], explained[number] & left
        words = _words(
            mistake, [m for m, fits in zip(mistakes, explained, strict=True) if fits[is_clear].all()]
        )
        for sensor in observations.sensor[is_clear].unique().tolist():
            is_own = (observations.sensor == sensor) & ~is_flagged
            also = _of_the_same(is_clear & is_own, mistake, expected)
            is_its = is_own & (is_clear | also)
            is_flagged, left = is_flagged | is_its, left & ~is_its
            reason = Reason.HELD if mistake.is_exact else Reason.OTHERWISE
            readings = is_its.nonzero().flatten().tolist()
            flags.append(Flag.of(observations, reason, words, mistake.component, readings))
            is_without = _would_show(mistake, expected) & (observations.sensor == sensor) & ~is_its
            may_be_causes |= _may_be_cause(mistake, observations.time_s, is_its, is_without)
    is_most = float(left.sum()) <= (1.0 - policy.LEAST_EXPLAINED_OF_FAR) * float(is_far.sum())
    return Suspects(_in_few_words(observations, flags) if is_most else [], may_be_causes)


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
    later_s = time_s[is_without & (time_s >= time_s[is_its].min())]
    return not len(later_s) or (mistake.is_reversal and bool((later_s > time_s[is_its].max()).all()))


def _explains(mistake: Mistake, expected: Expectation) -> Bool[Tensor, " reading"]:
    """Readings that a mistake would make fit, of those that it would change by far."""
    measured_T = expected.observations.field_sensor_T
    fits = (
        distance(measured_T, mistake.expected_T, mistake.magnifies * expected.size_T)
        < policy.NEAR_TO_EXPECTED
    )
    if mistake.is_exact:
        fits &= (measured_T == mistake.expected_T)[:, mistake.component]
    return fits & _would_show(mistake, expected, mistake.magnifies)


def _would_show(mistake: Mistake, expected: Expectation, magnified: float = 1.0) -> Bool[Tensor, " reading"]:
    """Readings that a mistake would change by far, with errors that are magnified."""
    off = distance(expected.predicted_T, mistake.expected_T, magnified * expected.size_T)
    return off > policy.FAR_FROM_EXPECTED


def _of_the_same(
    is_clear: Bool[Tensor, " reading"], mistake: Mistake, expected: Expectation
) -> Bool[Tensor, " reading"]:
    """Readings that a mistake explains better than none, where it was clearly made in several others.

    It changes them too little to show alone: those that miss still, and those between two that show it.
    """
    rows = is_clear.nonzero().flatten()
    if mistake.is_exact or len(rows) < policy.FEWEST_OF_ONE_MISTAKE:
        return torch.zeros_like(is_clear)
    by_mistake = distance(expected.observations.field_sensor_T, mistake.expected_T, expected.size_T)
    is_between = torch.zeros_like(is_clear)
    for before, after in pairwise(rows.tolist()):
        if after - before <= ROWS_BESIDE:
            is_between[before:after] = True
    is_better = (by_mistake < expected.misses - policy.BETTER_BY) & (
        by_mistake < mistake.magnifies * policy.NEAR_TO_EXPECTED
    )
    is_better &= ~mistake.expected_T.isnan().any(dim=1)
    return is_better & (is_between | (expected.misses > policy.NEAR_TO_EXPECTED))
