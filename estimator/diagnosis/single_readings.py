"""Readings that were recorded otherwise than they were measured, found one by one by what the fit of the others predicts for them.

A reading is flagged where it misses by far and one of few mistakes makes it fit: reversed, in another unit, two axes exchanged, of another
sensor, of a neighbouring row, or with a current that was off or reversed. The fit they are compared with is robust: readings that miss by
far are trimmed and the fit is repeated. Nothing is flagged unless those mistakes explain most of what misses by far: else it is the model
that is wrong.

References: the concentration steps of least trimmed squares, Rousseeuw and Van Driessen, Technometrics 41, 212 (1999).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit, fit_rig, resolution_T
from estimator.effects.use import as_meant
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.flags import Flag, Reason, in_time
from estimator.readings.observations import Observations
from estimator.readings.split import spread

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
SD_OF_MEDIAN = 1.4826  # standard deviation over median size, of normal errors


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
    predicted_T = _predicted_T(fit, fit.values, observations)
    size_T = _size_of_errors_T(observations, predicted_T)
    return bool((_misses(observations.field_sensor_T, predicted_T, size_T) > policy.FAR_FROM_EXPECTED).any())


def suspects_of(fit: Fit, observations: Observations) -> Suspects:
    """Readings that a mistake explains where the model of a fit does not; none unless mistakes explain most of what misses by far.

    Args:
        fit: Of the rig to some of the readings.
        observations: The readings to look at, a whole session.
    """
    suspects = _suspects(_robust(fit, fit.values, observations), observations)
    if suspects.flags:
        return suspects
    return _suspects(_robust(fit, fit.posterior.model.nominal, observations), observations)


def _robust(fit: Fit, values: Mapping[str, Tensor], observations: Observations) -> Fit:
    """The fit to readings that do not miss by far: first to the better half and some more of them, then to all that are near that fit.

    Args:
        fit: To some of the readings, whatever they hold.
        values: Where the first of those fits starts from.
        observations: The readings.
    """
    may_fit = observations.is_measured.any(dim=1) & ~observations.is_validation
    for trimming in range(policy.MOST_TRIMMINGS):
        predicted_T = _predicted_T(fit, values, observations)
        misses = _misses(
            observations.field_sensor_T, predicted_T, _size_of_errors_T(observations, predicted_T)
        )
        is_first = trimming < policy.TRIMMINGS_TO_A_SHARE
        most = misses[may_fit].quantile(1.0 - policy.MOST_TRIMMED) if is_first else policy.FAR_FROM_EXPECTED
        near = observations.rows(may_fit & (misses <= most))
        if len(near) < int((1.0 - policy.MOST_TRIMMED) * float(may_fit.sum())):
            return fit
        few = spread(near, policy.MOST_READINGS_SEARCHED)
        is_settled = not is_first and len(few) == len(fit.observations)
        fit = fit_rig(fit.rig, few, values, fit.posterior.model.rules, tolerance=policy.ROUGH_TOLERANCE)
        values = fit.values
        if is_settled:
            break
    return fit


def _suspects(fit: Fit, observations: Observations) -> Suspects:
    """The readings that miss by far, each flagged for the mistake that explains most of those left."""
    measured_T, predicted_T = observations.field_sensor_T, _predicted_T(fit, fit.values, observations)
    size_T = _size_of_errors_T(observations, predicted_T)
    is_far = _misses(measured_T, predicted_T, size_T) > policy.FAR_FROM_EXPECTED
    mistakes = list(_mistakes(fit, observations, predicted_T))
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
            would_show = _misses(predicted_T, mistake.expected_T, size_T) > policy.FAR_FROM_EXPECTED
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


def _predicted_T(
    fit: Fit, values: Mapping[str, Tensor], observations: Observations
) -> Float[Tensor, "reading 3"]:
    """What the rig of a fit predicts for readings, in the frames of their sensors."""
    fitted, meant = fit.posterior.model, as_meant(fit.rig, observations)
    model = MeasurementModel.unruled(fit.rig, meant).with_rules(fitted.rules).with_maps(fitted.sources.maps)
    with torch.no_grad():
        return model.predict(values).expand(len(observations), 3)


def _size_of_errors_T(
    observations: Observations, predicted_T: Float[Tensor, "reading 3"]
) -> Float[Tensor, " reading"]:
    """Standard deviation of the errors of most readings: of each sensor, and where fields are large a share of them."""
    errors_T = (observations.field_sensor_T - predicted_T).abs()
    field_T = predicted_T.norm(dim=1)
    size_T = torch.zeros_like(field_T)
    digit_T = resolution_T(observations.field_sensor_T[observations.is_measured])
    for sensor in observations.sensor.unique():
        own = observations.sensor == sensor
        typical_T = SD_OF_MEDIAN * errors_T[own].nanmedian()
        share = SD_OF_MEDIAN * (errors_T[own] / field_T[own, None].clamp(min=1e-12)).nanmedian()
        size_T[own] = torch.maximum(typical_T, share * field_T[own]).clamp(min=digit_T)
    return size_T


def _misses(
    measured_T: Float[Tensor, "reading 3"],
    expected_T: Float[Tensor, "reading 3"],
    size_T: Float[Tensor, " reading"],
) -> Float[Tensor, " reading"]:
    """Largest error of each reading's components in their standard deviations; 0 where nothing was measured or expected."""
    return ((measured_T - expected_T).abs() / size_T[:, None]).nan_to_num(0.0).amax(dim=1)


def _explains(
    mistake: Mistake,
    measured_T: Float[Tensor, "reading 3"],
    predicted_T: Float[Tensor, "reading 3"],
    size_T: Float[Tensor, " reading"],
) -> Bool[Tensor, " reading"]:
    """Readings that a mistake would make fit, of those that it would change by far."""
    size_T = mistake.magnifies * size_T
    changes = _misses(predicted_T, mistake.expected_T, size_T) > policy.FAR_FROM_EXPECTED
    fits = _misses(measured_T, mistake.expected_T, size_T) < policy.NEAR_TO_EXPECTED
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
    by_mistake = _misses(measured_T, mistake.expected_T, size_T)
    as_recorded = _misses(measured_T, predicted_T, size_T)
    is_between = torch.zeros_like(is_clear)
    for before, after in pairwise(rows.tolist()):
        if after - before <= ROWS_BESIDE:
            is_between[before:after] = True
    is_better = (by_mistake < as_recorded) & (by_mistake < mistake.magnifies * policy.NEAR_TO_EXPECTED)
    is_better &= ~mistake.expected_T.isnan().any(dim=1)
    return is_better & (is_between | (as_recorded > policy.NEAR_TO_EXPECTED))


def _mistakes(
    fit: Fit, observations: Observations, predicted_T: Float[Tensor, "reading 3"]
) -> Iterator[Mistake]:
    """All mistakes, those of one component first."""
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
    yield from _of_other_currents(fit, observations)
    yield from _of_other_readings(fit, observations, predicted_T)


def _of_other_currents(fit: Fit, observations: Observations) -> Iterator[Mistake]:
    """Fields of another current than recorded: that of one coil off or reversed, those of two coils exchanged."""
    names = [coil.name for coil in fit.rig.coils]
    for index, name in enumerate(names):
        for factor, state in ((-1.0, "reversed"), (0.0, "off")):
            current_A = observations.current_A.clone()
            current_A[:, index] *= factor
            expected_T = _predicted_T(fit, fit.values, replace(observations, current_A=current_A))
            words = f"fits a current of {name} that was {state}"
            yield Mistake(words, None, expected_T, is_reversal=factor == -1.0)
    for first in range(len(names)):
        for second in range(first + 1, len(names)):
            current_A = observations.current_A.clone()
            current_A[:, [first, second]] = observations.current_A[:, [second, first]]
            expected_T = _predicted_T(fit, fit.values, replace(observations, current_A=current_A))
            yield Mistake(f"fits currents of {names[first]} and {names[second]} exchanged", None, expected_T)


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
