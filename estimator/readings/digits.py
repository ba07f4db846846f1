"""What digits of the readings say without any model: sensors that stood still, copied blocks, filled stretches, bits that are stuck.

Sentinels and codes that wrapped around are found in `spoilt`.

Each needs a coincidence that noise does not make. Maps that symmetry repeats, and readings with less noise than their last digit, have
fields that agree to the last digit too. So a copy must be a block in the same order in which all three components change, a straight
line must end in kinks, and a reading that is repeated at other settings must begin and end in steps, in a session that repeats few or
each n-th.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from math import lgamma

import numpy as np
import numpy.typing as npt
from jaxtyping import Int

from estimator.readings.flags import Flag, Reason, in_time, runs_of
from estimator.readings.observations import Observations
from estimator.readings.spoilt import sentinels, wrapped
from estimator.tensors import Tensor

MOST_DECIMALS = 11  # of a tesla in which steps of the readings are looked for
MANY_STEPS = 30  # by which a component changes that noise and rounding leave alone
# Odd numbers, by which the bits of three components become one number; equal rows have equal ones.
HASHED_BY = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], dtype=np.uint64)
FEWEST_ROWS = 3  # of a sensor that are compared with each other
FEWEST_COPIED = 4  # consecutive readings
LEAST_MOVED = 0.01  # of its range that a current or a coordinate differs between a reading and its copy
MUCH_MOVED = 3.0  # times the usual change of settings between readings: from there on the field may jump
FEWEST_FILLED_IN = 3  # consecutive readings
FEWEST_EACH_NTH = 3  # rows that repeat the one before
MOST_BY_CHANCE = 1e-3  # stretches in which a reading is repeated as often, expected where the sensor works
COARSE = 2.5  # times the noise: a step whose rounding, a step over root 12, is three quarters of it
FEWEST_CODES = 30  # different ones beside a bit that is stuck: 30 coins that fall alike

WORDS = {
    Reason.HELD: "repeats the reading before to the last digit while place or current change",
    Reason.COPIED: "holds the fields of earlier readings",
    Reason.FILLED_IN: "lies on straight lines between neighbours",
    Reason.SENTINEL: "holds a number that stands for no reading",
    Reason.WRAPPED: "is off by 256 or 65536 steps of the last digit",
}

Codes = npt.NDArray[np.float64]


def flags_of_digits(observations: Observations) -> list[Flag]:
    """What the digits of each sensor's readings say, in the order of its readings in time.

    Examples:
        >>> import torch
        >>> from dataclasses import replace
        >>> n = torch.arange(40.0, dtype=torch.float64)
        >>> field_T = 1e-6 * torch.stack((n**2 % 997, n**3 % 991, 7 * n**2 % 983), 1).round()
        >>> field_T[20:30] = field_T[5:15]
        >>> readings = Observations.of(n[:, None], {}, field_T)
        >>> [(str(found.reason), found.where()) for found in flags_of_digits(readings)]
        [('copied', 'readings 21 to 30')]
    """
    flags: list[Flag] = []
    for sensor in observations.sensor.unique().tolist():
        own = in_time(observations, sensor).cpu()
        own_T = observations.field_sensor_T[own].cpu().numpy().astype(np.float64)
        steps_T = [step_of(component_T) for component_T in own_T.T]
        codes = np.stack([_codes(own_T[:, axis], steps_T[axis]) for axis in range(3)], axis=1)
        settings = _settings(observations, own)
        for reason, axis, rows in _spoilt(codes, steps_T, settings):
            flags.append(Flag.of(observations, reason, WORDS[reason], axis, own[rows].tolist()))
            codes[rows, axis] = np.nan
        held = sorted({*_held(codes, settings), *_held_each_nth(codes, settings)})
        codes[held] = np.nan
        alike = _perhaps_equal(codes)
        copied = _copied(codes, alike, settings) if len(alike) else []
        codes[copied] = np.nan
        filled_in = _filled_in(codes)
        codes[filled_in] = np.nan
        for reason, rows in ((Reason.HELD, held), (Reason.COPIED, copied), (Reason.FILLED_IN, filled_in)):
            if rows:
                flags.append(Flag.of(observations, reason, WORDS[reason], None, own[rows].tolist()))
        for axis in range(3):
            for bit, value in _stuck_bits(codes[:, axis]) if steps_T[axis] else ():
                words = f"has a bit of {steps_T[axis] * 2**bit * 1e6:.4g} µT that is always {value}"
                flags.append(Flag.of(observations, Reason.STUCK_BIT, words, axis, own.tolist()))
    return flags


def step_of(values_T: Codes) -> float:
    """The step in which values were written down, in T: the largest decimal fraction of which all are multiples; 0 where there is none.

    Examples:
        >>> step_of(np.array([0.0104, 0.0116, -0.0080]))
        0.0004
    """
    measured = values_T[~np.isnan(values_T)]
    for decimals in range(MOST_DECIMALS + 1):
        scaled = measured * 10.0**decimals
        whole = np.round(scaled)
        if len(whole) and bool((np.abs(scaled - whole) < 1e-4).all()) and bool((whole != whole[0]).any()):
            return float(np.gcd.reduce((whole - whole[0]).astype(np.int64))) / 10.0**decimals
    return 0.0


def coarse_steps_T(observations: Observations, noise_T: Sequence[float]) -> dict[int, float]:
    """Steps in which the components of some sensors are written down, by their numbers: where rounding is most of what scatters.

    Args:
        observations: Readings.
        noise_T: Of each sensor, one standard deviation of a component.
    """
    fields_T = observations.field_sensor_T.cpu().numpy().astype(np.float64)
    sensor = observations.sensor.cpu().numpy()
    steps_T = {i: max(map(step_of, fields_T[sensor == i].T)) for i in range(len(noise_T))}
    return {i: step_T for i, step_T in steps_T.items() if step_T > COARSE * noise_T[i]}


def _codes(values_T: Codes, step_T: float) -> Codes:
    """Values in steps of the last digit; where there is none, in units so small that equality is equality."""
    return np.round(values_T / step_T) if step_T else values_T / 1e-12


def _settings(observations: Observations, own: Int[Tensor, " own"]) -> Codes:
    """Currents and poses of a sensor's readings, each over its range, without those that never change."""
    columns = []
    for values in (observations.current_A, *observations.motion.values()):
        for column in values.cpu().numpy().T:
            mine = column[own].astype(np.float64)
            if (wide := float(np.ptp(mine))) > 0.0:
                columns.append(mine / wide)
    return np.stack(columns or [np.zeros(len(own))], axis=1)


def _spoilt(codes: Codes, steps_T: list[float], settings: Codes) -> Iterator[tuple[Reason, int, list[int]]]:
    """Rows that hold sentinels or wrapped codes, by component; a component is judged without those found before."""
    change = np.abs(np.diff(settings, axis=0)).max(axis=1, initial=0.0)
    is_set_anew = change > max(LEAST_MOVED, MUCH_MOVED * float(np.median(change)) if len(change) else 0.0)
    for axis in range(3):
        if steps_T[axis]:
            if rows := sentinels(codes[:, axis]):
                yield Reason.SENTINEL, axis, rows
            if rows := wrapped(codes[:, axis], is_set_anew):
                yield Reason.WRAPPED, axis, rows


def _held(codes: Codes, settings: Codes) -> list[int]:
    """Rows that repeat all components of the row before while settings change, in stretches that begin and end in steps of the field.

    A field of few steps of the last digit is repeated by nature, and so is a uniform one; that one is reached without a step.
    """
    if len(codes) < FEWEST_ROWS:
        return []
    change = np.abs(np.diff(codes, axis=0))
    is_compared: npt.NDArray[np.bool_] = np.logical_not(np.isnan(change).all(axis=1))
    is_repeated: npt.NDArray[np.bool_] = is_compared & (np.nan_to_num(change) == 0.0).all(axis=1)
    is_repeated &= (np.isnan(codes[1:]) == np.isnan(codes[:-1])).all(axis=1)
    if not is_repeated.any():
        return []
    is_moved: npt.NDArray[np.bool_] = np.abs(np.diff(settings, axis=0)).max(axis=1, initial=0.0) > LEAST_MOVED
    is_large: npt.NDArray[np.bool_] = np.nan_to_num(np.abs(codes[1:])).max(axis=1) > MANY_STEPS
    is_step: npt.NDArray[np.bool_] = np.nan_to_num(change).max(axis=1) > MANY_STEPS
    is_counted = (
        np.stack((is_moved, ~is_moved)) & is_compared & is_large
    )  # a reading may well be repeated at one place
    steps = np.stack((is_counted, is_counted & is_repeated)).sum(axis=2)  # all of them, and those that repeat
    last_moved = np.maximum.accumulate(np.where(is_compared & is_moved, np.arange(len(change)), -1))
    rows: list[int] = []
    for run in sorted(runs_of(np.flatnonzero(is_repeated).tolist()), key=len, reverse=True):
        n_held = is_counted[:, run].sum(axis=1)
        elsewhere = steps - n_held
        log_chance = np.log(len(change)) + n_held @ np.log((elsewhere[1] + 1) / (elsewhere[0] + 2))
        before, after = last_moved[run[0] - 1] if run[0] else -1, run[-1] + 1
        beside = [step for step in (before, after) if 0 <= step < len(change) and is_compared[step]]
        is_sharp = bool(beside) and bool(is_step[beside].all())
        if log_chance < np.log(MOST_BY_CHANCE) and is_sharp and is_moved[run].any():
            rows += [step + 1 for step in run[int(is_moved[run].argmax()) :]]
            steps = elsewhere
    return sorted(rows)


def _held_each_nth(codes: Codes, settings: Codes) -> list[int]:
    """Each n-th row, where all that were taken at other settings repeat the row before, between steps of the field, and no others do.

    A sensor that had no new reading when it was asked, as where a logger is a little faster than its sensor.
    """
    change = np.abs(np.diff(codes, axis=0))
    is_moved = np.abs(np.diff(settings, axis=0)).max(axis=1, initial=0.0) > LEAST_MOVED
    is_counted = is_moved & ~np.isnan(change).any(axis=1)
    is_repeated = is_counted & (np.nan_to_num(change) == 0.0).all(axis=1)
    repeated = np.flatnonzero(is_repeated)
    if len(repeated) < FEWEST_EACH_NTH:
        return []
    first, last, n = repeated[0], repeated[-1], int(np.gcd.reduce(np.diff(repeated)))
    is_nth = is_counted.copy()
    is_nth[:first] = is_nth[last + 1 :] = False
    is_nth &= (np.arange(len(change)) - first) % n == 0
    is_step = np.append(np.nan_to_num(change).max(axis=1) > MANY_STEPS, True)
    # Of all ways to choose as many rows those with some n, begin and end.
    log_chance = np.log(n) + 2.0 * np.log(len(change)) - _log_ways(int(is_counted.sum()), len(repeated))
    # Where symmetry repeats readings, it repeats others than neighbours too.
    is_symmetric = len(np.setdiff1d(_perhaps_equal(codes), (repeated, repeated + 1))) > len(repeated)
    is_told = log_chance < np.log(MOST_BY_CHANCE) and bool(is_step[repeated + 1].all()) and not is_symmetric
    return (repeated + 1).tolist() if is_told and (is_nth == is_repeated).all() else []


def _log_ways(n: int, k: int) -> float:
    """Logarithm of the number of ways to choose k of n."""
    return lgamma(n + 1) - lgamma(k + 1) - lgamma(n - k + 1)


def _copied(codes: Codes, alike: npt.NDArray[np.intp], settings: Codes) -> list[int]:
    """Rows, among those alike, of blocks that repeat an earlier block at other settings while every component changes within it."""
    same: dict[bytes, list[int]] = {}
    for row in alike:
        same.setdefault((codes[row] + 0.0).tobytes(), []).append(int(row))
    later_by_lag: dict[int, list[int]] = {}
    for equal in same.values():
        for earlier, later in pairwise(equal):
            if np.abs(settings[later] - settings[earlier]).max() > LEAST_MOVED:
                later_by_lag.setdefault(later - earlier, []).append(later)
    rows: set[int] = set()
    for copies in later_by_lag.values():
        for block in runs_of(sorted(copies)):
            values = codes[block]
            if (
                len(np.unique(values, axis=0)) >= FEWEST_COPIED
                and (np.ptp(values, axis=0) > MANY_STEPS).all()
            ):
                rows.update(block)
    return sorted(rows)


def _perhaps_equal(codes: Codes) -> npt.NDArray[np.intp]:
    """Complete rows that may equal another one, in order: among a million readings hardly any, and only these are compared one by one."""
    rows = np.flatnonzero(~np.isnan(codes).any(axis=1))
    hashes = (codes[rows] + 0.0).view(np.uint64) @ HASHED_BY
    _, index, counts = np.unique(hashes, return_inverse=True, return_counts=True)
    return rows[counts[index] > 1]


def _filled_in(codes: Codes) -> list[int]:
    """Rows on a straight line that ends in kinks, while at least two components change from row to row."""
    if len(codes) < FEWEST_FILLED_IN + 2:
        return []
    bend = np.full(codes.shape, np.nan)
    bend[1:-1] = np.abs(codes[2:] - 2.0 * codes[1:-1] + codes[:-2])
    slope = np.full(codes.shape, np.nan)
    slope[1:] = np.abs(np.diff(codes, axis=0))
    is_straight = (bend <= 2.0).all(axis=1) & ((slope > MANY_STEPS).sum(axis=1) >= 2)
    is_kink = (bend > MANY_STEPS).sum(axis=1) >= 2
    rows: list[int] = []
    for line in runs_of(np.flatnonzero(is_straight).tolist()):
        if len(line) >= FEWEST_FILLED_IN and is_kink[line[0] - 1] and is_kink[line[-1] + 1]:
            rows += line
    return rows


def _stuck_bits(codes: Codes) -> Iterator[tuple[int, int]]:
    """Bits of a component that are the same in all readings though higher ones and lower ones change, with their values."""
    whole = codes[~np.isnan(codes)].astype(np.int64)
    if not len(whole):
        return
    always_one, once_one = int(np.bitwise_and.reduce(whole)), int(np.bitwise_or.reduce(whole))
    lowest, highest = int(whole.min()), int(whole.max())
    for bit in range(63):
        if (highest >> (bit + 1)) - (lowest >> (bit + 1)) < FEWEST_CODES - 1:
            return  # there are fewer codes than these
        is_one, may_be_one = always_one >> bit & 1, once_one >> bit & 1
        if is_one == may_be_one and len(np.unique(whole >> (bit + 1))) >= FEWEST_CODES:
            yield bit, is_one
