"""Readings that were recorded otherwise than they were measured, found one by one by what the fit of the others predicts for them.

A reading is flagged where it misses by far and one of few mistakes makes it fit: reversed, in another unit, two axes exchanged, of another
sensor, of a neighbouring row, or with a current that was off or reversed. The fit they are compared with is robust (`robust_fit`). Nothing
is flagged unless those mistakes explain most of what misses by far: else it is the model that is wrong.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.robust_fit import misses, predict_T, robust_fit, size_of_errors_T
from estimator.readings.flags import Flag, Reason, in_time
from estimator.readings.observations import Observations

FACTORS = {
    0.0: "is zero",
    -1.0: "is reversed",
    10.0: "is ten times too large",
    0.1: "is ten times too small",
    100.0: "is a hundred times too large",
    0.01: "is a hundred times too small",
    1000.0: "is a thousand times too large",
    1e-3: "is a thousand times too small",
}
OF_ANOTHER_ROW = "holds the field of the reading"
FEW_NEIGHBOURS = 2  # rows that readings were exchanged with, listed one by one
ROWS_BESIDE = 8  # how many rows away a field may have been written down


@dataclass(frozen=True)
class Mistake:
    """One way to write readings down wrongly.

    Attributes:
        words: What it does to them, as a clause.
        component: Index of the component that it concerns; None where it concerns all three.
        expected_T: Each reading as this mistake would have it, in the frame of its sensor; NaN where it cannot have been made.
        magnifies: Factor by which it makes errors of the readings larger.
        is_exact: Whether it repeats recorded digits, so that it fits exactly or not at all.
        is_reversal: Whether it reverses a current, or all that a sensor reads.
    """

    words: str
    component: int | None
    expected_T: Float[Tensor, "reading 3"]
    magnifies: float = 1.0
    is_exact: bool = False
    is_reversal: bool = False


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
    predicted_T = predict_T(fit, fit.values, observations)
    size_T = size_of_errors_T(observations, predicted_T)
    return bool((misses(observations.field_sensor_T, predicted_T, size_T) > policy.FAR_FROM_EXPECTED).any())


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
    measured_T, predicted_T = observations.field_sensor_T, predict_T(fit, values, observations)
    size_T = size_of_errors_T(observations, predicted_T)
    is_far = misses(measured_T, predicted_T, size_T) > policy.FAR_FROM_EXPECTED
    if not bool(is_far.any()):
        return Suspects([], False)
    mistakes = [
        *_of_what_was_expected(observations, predicted_T),
        *_of_other_currents(fit, values, observations, is_far, size_T),
        *_of_other_readings(fit, observations, predicted_T),
    ]
    explained = torch.stack([is_far & _explains(m, measured_T, predicted_T, size_T) for m in mistakes])
    left, is_flagged = is_far.clone(), torch.zeros_like(is_far)
    flags, may_be_causes = list[Flag](), False
    while bool((explained & left).any()):
        number = int((explained & left).sum(dim=1).argmax())
        mistake, is_clear = mistakes[number], explained[number] & left
        for sensor in observations.sensor[is_clear].unique().tolist():
            is_own = (observations.sensor == sensor) & ~is_flagged
            also = _of_the_same(is_clear & is_own, mistake, measured_T, predicted_T, size_T)
            is_its = is_own & (is_clear | also)
            is_flagged, left = is_flagged | is_its, left & ~is_its
            reason = Reason.HELD if mistake.is_exact else Reason.OTHERWISE
            readings = is_its.nonzero().flatten().tolist()
            flags.append(Flag.of(observations, reason, mistake.words, mistake.component, readings))
            would_show = misses(predicted_T, mistake.expected_T, size_T) > policy.FAR_FROM_EXPECTED
            is_without = would_show & (observations.sensor == sensor) & ~is_its
            may_be_causes |= _may_be_cause(mistake, observations.time_s, is_its, is_without)
    is_most = float(left.sum()) <= (1.0 - policy.LEAST_EXPLAINED_OF_FAR) * float(is_far.sum())
    return Suspects(_in_few_words(observations, flags) if is_most else [], may_be_causes)


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


def _explains(
    mistake: Mistake,
    measured_T: Float[Tensor, "reading 3"],
    predicted_T: Float[Tensor, "reading 3"],
    size_T: Float[Tensor, " reading"],
) -> Bool[Tensor, " reading"]:
    """Readings that a mistake would make fit, of those that it would change by far."""
    size_T = mistake.magnifies * size_T
    changes = misses(predicted_T, mistake.expected_T, size_T) > policy.FAR_FROM_EXPECTED
    fits = misses(measured_T, mistake.expected_T, size_T) < policy.NEAR_TO_EXPECTED
    if mistake.is_exact:
        fits &= (measured_T == mistake.expected_T)[:, mistake.component]
    return changes & fits


def _of_the_same(
    is_clear: Bool[Tensor, " reading"],
    mistake: Mistake,
    measured_T: Float[Tensor, "reading 3"],
    predicted_T: Float[Tensor, "reading 3"],
    size_T: Float[Tensor, " reading"],
) -> Bool[Tensor, " reading"]:
    """Readings that a mistake explains better than none, where it was clearly made in several others.

    It changes them too little to show alone: those that miss still, and those between two that show it.
    """
    rows = is_clear.nonzero().flatten()
    if mistake.is_exact or len(rows) < policy.FEWEST_OF_ONE_MISTAKE:
        return torch.zeros_like(is_clear)
    by_mistake = misses(measured_T, mistake.expected_T, size_T)
    as_recorded = misses(measured_T, predicted_T, size_T)
    is_between = torch.zeros_like(is_clear)
    for before, after in pairwise(rows.tolist()):
        if after - before <= ROWS_BESIDE:
            is_between[before:after] = True
    is_better = (by_mistake < as_recorded) & (by_mistake < mistake.magnifies * policy.NEAR_TO_EXPECTED)
    is_better &= ~mistake.expected_T.isnan().any(dim=1)
    return is_better & (is_between | (as_recorded > policy.NEAR_TO_EXPECTED))


def _of_what_was_expected(
    observations: Observations, predicted_T: Float[Tensor, "reading 3"]
) -> Iterator[Mistake]:
    """Mistakes that follow from what is expected of all readings, those of one component first."""
    before = _beside(observations, 1)
    for axis in range(3):
        for factor, words in FACTORS.items():
            expected_T = predicted_T.clone()
            expected_T[:, axis] *= factor
            yield Mistake(words, axis, expected_T, max(abs(factor), 1.0))
        held_T = predicted_T.clone()
        held_T[:, axis] = torch.where(before >= 0, observations.field_sensor_T[before, axis], torch.nan)
        yield Mistake("repeats the reading before to the last digit", axis, held_T, is_exact=True)
    for factor, words in FACTORS.items():
        yield Mistake(words, None, factor * predicted_T, max(abs(factor), 1.0), is_reversal=factor == -1.0)
    for first, second in ((0, 1), (0, 2), (1, 2)):
        order = [0, 1, 2]
        order[first], order[second] = second, first
        yield Mistake(f"has {'xyz'[first]} and {'xyz'[second]} exchanged", None, predicted_T[:, order])


def _of_other_currents(
    fit: Fit,
    values: Mapping[str, Tensor],
    observations: Observations,
    is_far: Bool[Tensor, " reading"],
    size_T: Float[Tensor, " reading"],
) -> Iterator[Mistake]:
    """Fields of other currents than recorded, of those that make one of the readings fit that miss by far."""
    far = observations.rows(is_far)
    for words, real_of_recorded, is_reversal in _other_currents([coil.name for coil in fit.rig.coils]):
        expected_T = predict_T(fit, values, _driven(far, real_of_recorded))
        if not bool((misses(far.field_sensor_T, expected_T, size_T[is_far]) < policy.NEAR_TO_EXPECTED).any()):
            continue
        yield Mistake(
            words,
            None,
            predict_T(fit, values, _driven(observations, real_of_recorded)),
            is_reversal=is_reversal,
        )


def _driven(observations: Observations, real_of_recorded: Float[Tensor, "coil coil"]) -> Observations:
    """The readings with other currents than recorded."""
    return replace(
        observations, current_A=observations.current_A @ real_of_recorded.to(observations.current_A)
    )


def _other_currents(coils: Sequence[str]) -> Iterator[tuple[str, Float[Tensor, "coil coil"], bool]]:
    """The current of one coil off or reversed, those of two coils exchanged: in words, as a matrix, whether it is a reversal."""
    as_recorded = torch.eye(len(coils), dtype=torch.float64)
    for index, name in enumerate(coils):
        for factor, state in ((-1.0, "reversed"), (0.0, "off")):
            matrix = as_recorded.clone()
            matrix[index, index] = factor
            yield f"fits a current of {name} that was {state}", matrix, factor == -1.0
    for first, second in combinations(range(len(coils)), 2):
        matrix = as_recorded.clone()
        matrix[[first, second]] = matrix[[second, first]]
        yield f"fits currents of {coils[first]} and {coils[second]} exchanged", matrix, False


def _of_other_readings(
    fit: Fit, observations: Observations, predicted_T: Float[Tensor, "reading 3"]
) -> Iterator[Mistake]:
    """Fields of the reading some rows before or after, and of another sensor at the same time."""
    for rows in sorted((*range(-ROWS_BESIDE, 0), *range(1, ROWS_BESIDE + 1)), key=abs):
        other = _beside(observations, rows)
        expected_T = predicted_T[other].masked_fill((other < 0)[:, None], torch.nan)
        way = "before" if rows > 0 else "after"
        words = f"{OF_ANOTHER_ROW} {abs(rows)} {'row' if abs(rows) == 1 else 'rows'} {way}"
        yield Mistake(words, None, expected_T)
    for index, sensor in enumerate(fit.rig.sensors):
        order = in_time(observations, index)
        if not 0 < len(order) < len(observations):
            continue
        times_s = observations.time_s[order].contiguous()
        after = torch.searchsorted(times_s, observations.time_s.contiguous()).clamp(max=len(order) - 1)
        earlier = (after - 1).clamp(min=0)
        is_earlier = (observations.time_s - times_s[earlier]).abs() < (
            observations.time_s - times_s[after]
        ).abs()
        expected_T = predicted_T[order[torch.where(is_earlier, earlier, after)]]
        is_own = (observations.sensor == index)[:, None]
        yield Mistake(f"holds the field of {sensor.name}", None, expected_T.masked_fill(is_own, torch.nan))


def _beside(observations: Observations, rows: int) -> Int[Tensor, " reading"]:
    """For each reading the number of that of the same sensor some rows before; -1 where there is none."""
    other = torch.full_like(observations.sensor, -1)
    for sensor in observations.sensor.unique():
        own = in_time(observations, int(sensor))
        place = torch.arange(len(own), device=own.device) - rows
        is_there = (place >= 0) & (place < len(own))
        other[own[is_there]] = own[place[is_there]]
    return other
