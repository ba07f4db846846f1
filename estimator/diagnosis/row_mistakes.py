"""Ways to write a row of a table down wrongly, each with the fields that rows would then hold.

A field may be reversed, in another unit, with two axes exchanged, of another sensor or row; a counter may have wrapped; or it was measured
with another current or at another place than the row says, as where the pose is that of the row before.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from estimator.diagnosis import policy
from estimator.diagnosis.expectation import Expectation, distance, predict_T
from estimator.diagnosis.fitting import Fit
from estimator.readings.digits import step_of
from estimator.readings.flags import in_time
from estimator.readings.observations import Observations
from estimator.rig.rig import Rig

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
MOST_COUNTS = 2**16
COUNTERS = {
    MOST_COUNTS: "is off by a multiple of 65536 counts, as of a counter of 16 bits that wrapped",
    2**8: "is off by a multiple of 256 counts, as of two bytes that were read at different times",
}
OF_ANOTHER_ROW = "holds the field of the reading"
ROWS_BESIDE = 8  # how many rows away a field may have been written down
MOST_EXCHANGED = 200  # rows that miss by far among which pairs are looked for: exchanges are few


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
        real: The readings with the settings that they were taken at, where others were recorded.
        follows_field: Whether it is made where the field is large, so that its rows follow the field.
        log_choices: Logarithm of the number of fields that a reading with this mistake may hold.
        is_of_rows: Whether it is made in single rows only, so that no cause of the library is like it.
        is_anywhere: Whether its field may be anything that its sensor reads.
    """

    words: str
    component: int | None
    expected_T: Float[Tensor, "reading 3"]
    magnifies: float = 1.0
    is_exact: bool = False
    is_reversal: bool = False
    real: Observations | None = None
    follows_field: bool = False
    log_choices: float = 0.0
    is_of_rows: bool = False
    is_anywhere: bool = False


def mistakes_of(fit: Fit, values: Mapping[str, Tensor], expected: Expectation) -> list[Mistake]:
    """All mistakes, those of one component first; of those that need a prediction of their own the ones that make a reading fit.

    Args:
        fit: Of the rig.
        values: Of its parameters.
        expected: Of the readings as they are, by these values.
    """
    readings = expected.observations
    return [
        *_of_what_was_expected(expected),
        *_of_counters(expected),
        *_of_settings((*_other_currents(fit.rig), *_other_poses(fit.rig, readings)), fit, values, expected),
        *_of_other_readings(fit.rig, expected),
        *_of_settings(_poses_beside(fit.rig, readings), fit, values, expected),
        *_of_exchanged_readings(expected),
        _of_a_repeated_setting(expected),
    ]


def _of_what_was_expected(expected: Expectation) -> Iterator[Mistake]:
    """Mistakes that follow from what is expected of all readings, those of one component first."""
    measured_T, predicted_T = expected.observations.field_sensor_T, expected.predicted_T
    before = _beside(expected.observations, 1)
    for axis in range(3):
        for factor, words in FACTORS.items():
            expected_T = predicted_T.clone()
            expected_T[:, axis] *= factor
            yield Mistake(words, axis, expected_T, max(abs(factor), 1.0))
        held_T = predicted_T.clone()
        held_T[:, axis] = torch.where(before >= 0, measured_T[before, axis], torch.nan)
        yield Mistake("repeats the reading before to the last digit", axis, held_T, is_exact=True)
    for factor, words in FACTORS.items():
        yield Mistake(words, None, factor * predicted_T, max(abs(factor), 1.0), is_reversal=factor == -1.0)
    for first, second in ((0, 1), (0, 2), (1, 2)):
        order = [0, 1, 2]
        order[first], order[second] = second, first
        yield Mistake(f"has {'xyz'[first]} and {'xyz'[second]} exchanged", None, predicted_T[:, order])


def _of_counters(expected: Expectation) -> Iterator[Mistake]:
    """Fields that are whole multiples of the counts of one or two bytes off, in counts of the last digit of each component."""
    measured_T, predicted_T = expected.observations.field_sensor_T, expected.predicted_T
    count_T = torch.zeros_like(measured_T)
    for sensor in expected.observations.sensor.unique().tolist():
        own = expected.observations.sensor == sensor
        count_T[own] = count_T.new_tensor(
            [step_of(of_axis_T) for of_axis_T in measured_T[own].cpu().numpy().T]
        )
    explained = torch.zeros_like(expected.is_far)
    for counts, words in COUNTERS.items():
        multiple = ((measured_T - predicted_T) / (counts * count_T)).nan_to_num(0.0, 0.0, 0.0).round()
        is_off = multiple.any(dim=1) & expected.is_far & ~explained
        if not bool(is_off.any()):
            continue
        # Another reading would be one multiple off, had this been made in it.
        expected_T = predicted_T + torch.where(is_off[:, None], multiple, 1.0) * counts * count_T
        choices = 2.0 * float(multiple[is_off].abs().max()) + 1.0
        yield Mistake(
            words, None, expected_T, follows_field=counts == MOST_COUNTS, log_choices=3.0 * math.log(choices)
        )
        off = distance(measured_T, expected_T, expected.size_T)
        explained |= is_off & (off < policy.NEAR_TO_EXPECTED)


def _of_settings(
    settings: Iterable[_Setting], fit: Fit, values: Mapping[str, Tensor], expected: Expectation
) -> Iterator[Mistake]:
    """Fields of other currents or poses than recorded, of those that make one of the readings fit that miss by far."""
    is_far = expected.is_far
    far_T, size_T = expected.observations.field_sensor_T[is_far], expected.size_T[is_far]
    for setting in settings:
        real = setting.of(expected.observations)
        there_T = predict_T(fit, values, real.rows(is_far))
        if bool((distance(far_T, there_T, size_T) < policy.NEAR_TO_EXPECTED).any()):
            real_T = predict_T(fit, values, real)
            yield Mistake(setting.words, None, real_T, is_reversal=setting.is_reversed_current, real=real)


class _Setting(NamedTuple):
    """Currents, or columns of a mover, that were otherwise than recorded.

    Attributes:
        words: How, as a clause.
        mover: Whose columns; None for currents.
        matrix: The recorded ones times this are the real ones; None where they are those of another reading.
        is_reversed_current: Whether the current of one coil is reversed.
        other: Number of the reading that has the real ones.
    """

    words: str
    mover: str | None
    matrix: Float[Tensor, "column column"] | None
    is_reversed_current: bool = False
    other: Int[Tensor, " reading"] | None = None

    def of(self, observations: Observations) -> Observations:
        """Readings with the real settings."""
        recorded = observations.current_A if self.mover is None else observations.motion[self.mover]
        real = recorded if self.other is None else recorded[self.other]
        real = real if self.matrix is None else real @ self.matrix.to(real)
        if self.mover is None:
            return replace(observations, current_A=real)
        return replace(observations, motion={**observations.motion, self.mover: real})


def _other_currents(rig: Rig) -> Iterator[_Setting]:
    """The current of one coil off or reversed, those of two coils exchanged."""
    names, n = [coil.name for coil in rig.coils], len(rig.coils)
    for i, name in enumerate(names):
        yield _Setting(f"fits a current of {name} that was reversed", None, _times(-1.0, i, n), True)
        yield _Setting(f"fits a current of {name} that was off", None, _times(0.0, i, n))
    for i, k in combinations(range(n), 2):
        yield _Setting(f"fits currents of {names[i]} and {names[k]} exchanged", None, _exchanged(i, k, n))


def _other_poses(rig: Rig, observations: Observations) -> Iterator[_Setting]:
    """One column of a mover with the other sign, a length ten times too large or too small, two lengths exchanged."""
    for mover in rig.movers:
        columns, n = mover.columns, len(mover.columns)
        is_used = observations.motion[mover.name].any(dim=0).tolist()
        used = [i for i in range(n) if is_used[i]]
        lengths = [i for i in used if columns[i].endswith("_m")]
        for i in used:
            yield _Setting(f"fits {columns[i]} with the other sign", mover.name, _times(-1.0, i, n))
        for i in lengths:
            yield _Setting(f"fits a tenth of {columns[i]}", mover.name, _times(0.1, i, n))
            yield _Setting(f"fits ten times {columns[i]}", mover.name, _times(10.0, i, n))
        for i, k in combinations(lengths, 2):
            words = f"fits {columns[i]} and {columns[k]} exchanged"
            yield _Setting(words, mover.name, _exchanged(i, k, n))


def _poses_beside(rig: Rig, observations: Observations) -> Iterator[_Setting]:
    """The pose of the reading after, where that of the reading before was written down, and the other way round."""
    for rows, way in ((-1, "after"), (1, "before")):
        other = _beside(observations, rows)
        other = torch.where(other < 0, torch.arange(len(other), device=other.device), other)
        for mover in rig.movers:
            words = f"fits the pose that {mover.name} has in the reading {way}"
            yield _Setting(words, mover.name, None, other=other)


def _times(factor: float, column: int, n: int) -> Float[Tensor, "column column"]:
    matrix = torch.eye(n, dtype=torch.float64)
    matrix[column, column] = factor
    return matrix


def _exchanged(first: int, second: int, n: int) -> Float[Tensor, "column column"]:
    matrix = torch.eye(n, dtype=torch.float64)
    matrix[[first, second]] = matrix[[second, first]]
    return matrix


def _of_other_readings(rig: Rig, expected: Expectation) -> Iterator[Mistake]:
    """Fields of the reading some rows before or after, and of another sensor at the same time."""
    observations, predicted_T = expected.observations, expected.predicted_T
    for rows in sorted((*range(-ROWS_BESIDE, 0), *range(1, ROWS_BESIDE + 1)), key=abs):
        other = _beside(observations, rows)
        expected_T = predicted_T[other].masked_fill((other < 0)[:, None], torch.nan)
        way = "before" if rows > 0 else "after"
        words = f"{OF_ANOTHER_ROW} {abs(rows)} {'row' if abs(rows) == 1 else 'rows'} {way}"
        yield Mistake(words, None, expected_T)
    for index, sensor in enumerate(rig.sensors):
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


def _of_exchanged_readings(expected: Expectation) -> Iterator[Mistake]:
    """Each reading of a pair of one sensor holds the field of the other, however far apart they are."""
    far = expected.is_far.nonzero().flatten()
    if not 1 < len(far) <= MOST_EXCHANGED:
        return
    measured_T, predicted_T = expected.observations.field_sensor_T[far], expected.predicted_T[far]
    off = ((measured_T[:, None] - predicted_T).abs() / expected.size_T[far, None, None]).nan_to_num(0.0)
    sensor = expected.observations.sensor[far]
    apart = off.amax(dim=2).masked_fill(sensor[:, None] != sensor, math.inf)
    least, partner = torch.maximum(apart, apart.mT).min(dim=1)
    is_pair = (least < policy.NEAR_TO_EXPECTED) & (partner[partner] == torch.arange(len(far)).to(partner))
    if bool(is_pair.any()):
        expected_T = torch.full_like(expected.predicted_T, torch.nan)
        expected_T[far[is_pair]] = predicted_T[partner[is_pair]]
        choices = math.log(len(expected.is_far))
        words = "is exchanged with another reading"
        yield Mistake(words, None, expected_T, log_choices=choices, is_of_rows=True)


def _of_a_repeated_setting(expected: Expectation) -> Mistake:
    """Pose and currents are those of the reading before, for the new ones had not arrived: nothing says what the field should be.

    A wild value may be as far off. That it falls on a repeated setting is the less probable by chance the fewer there are.
    """
    observations = expected.observations
    before = _beside(observations, 1)
    settings = torch.cat((observations.current_A, *observations.motion.values()), dim=1)
    is_repeated = (before >= 0) & (settings == settings[before]).all(dim=1)
    share = (float((is_repeated & ~expected.is_far).sum()) + 0.5) / (len(before) + 1.0)
    expected_T = torch.where(is_repeated[:, None], observations.field_sensor_T, torch.nan)
    words = "has the pose and the currents of the reading before, but another field"
    choices = math.log(share)
    return Mistake(words, None, expected_T, log_choices=choices, is_of_rows=True, is_anywhere=True)


def _beside(observations: Observations, rows: int) -> Int[Tensor, " reading"]:
    """For each reading the number of that of the same sensor some rows before; -1 where there is none."""
    other = torch.full_like(observations.sensor, -1)
    for sensor in observations.sensor.unique():
        own = in_time(observations, int(sensor))
        place = torch.arange(len(own), device=own.device) - rows
        is_there = (place >= 0) & (place < len(own))
        other[own[is_there]] = own[place[is_there]]
    return other
