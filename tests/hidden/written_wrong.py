"""Fields and places that were written down otherwise than they were, in some rows: by spreadsheets, loggers, operators, registers.

The rows are changed after everything else, noise included, so what is right in them stays as it was measured.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Fields = npt.NDArray[np.float64]
Rows = npt.NDArray[np.int64]

DIGIT_T = 1e-7  # to which the laboratory writes its readings
HALF_OF_COUNTS, LEAST_COUNT_T = 2**15, 1e-9


class Written(NamedTuple):
    """Fields as they were written down, and the rows in which they are not what was measured."""

    field_T: Fields
    wrong: Rows


def written(kind: str, field_T: Fields, rng: np.random.Generator) -> Written:
    """A laboratory's table with one mistake in it; fields of one sensor in order of time, in T."""
    measured = np.round(field_T / DIGIT_T) * DIGIT_T
    changed, rows = (KINDS | LATER_KINDS)[kind](measured.copy(), rng)
    return Written(changed if kind == "wrapped" else np.round(changed / DIGIT_T) * DIGIT_T, rows)


def _pasted(field_T: Fields, rng: np.random.Generator) -> tuple[Fields, Rows]:
    """A block of rows is pasted a second time, over the block that follows it."""
    n = int(rng.integers(6, 20))
    begin = int(rng.integers(0, len(field_T) - 2 * n))
    field_T[begin + n : begin + 2 * n] = field_T[begin : begin + n]
    return field_T, np.arange(begin + n, begin + 2 * n)


def _interpolated(field_T: Fields, rng: np.random.Generator) -> tuple[Fields, Rows]:
    """Rows that were lost are filled in by a spreadsheet, along a straight line."""
    n = int(rng.integers(4, 9))
    begin = int(rng.integers(1, len(field_T) - n - 1))
    share = np.arange(1, n + 1)[:, None] / (n + 1)
    rows = np.arange(begin, begin + n)
    field_T[rows] = (1.0 - share) * field_T[begin - 1] + share * field_T[begin + n]
    return field_T, rows


def _stale(field_T: Fields, rng: np.random.Generator) -> tuple[Fields, Rows]:
    """The register of one axis is read before it was written anew, now and then."""
    axis = int(rng.integers(3))
    rows = np.flatnonzero(rng.random(len(field_T) - 1) < rng.uniform(0.04, 0.12)) + 1
    for row in rows:
        field_T[row, axis] = field_T[row - 1, axis]
    return field_T, rows


def _gauss(field_T: Fields, rng: np.random.Generator) -> tuple[Fields, Rows]:
    """One axis is written down in another unit for a while."""
    axis, rows = int(rng.integers(3)), _a_while(len(field_T), rng)
    field_T[rows, axis] *= rng.choice([0.1, 10.0])
    return field_T, rows


def _unsigned(field_T: Fields, rng: np.random.Generator) -> tuple[Fields, Rows]:
    """One operator reads the sign the wrong way, in some rows all over the session."""
    rows = _some(len(field_T), rng)
    field_T[rows] *= -1.0
    return field_T, rows


def _columns(field_T: Fields, rng: np.random.Generator) -> tuple[Fields, Rows]:
    """Two columns are exchanged for a while."""
    return _two_exchanged(field_T, rng)


def _neighbour_row(field_T: Fields, rng: np.random.Generator) -> tuple[Fields, Rows]:
    """A row is left out and another written twice at the end of a page, so that a stretch between them is one row off."""
    rows = _a_while(len(field_T), rng)
    measured = field_T.copy()
    field_T[rows] = measured[rows - 1]
    return field_T, rows


def _wrapped(field_T: Fields, rng: np.random.Generator) -> tuple[Fields, Rows]:
    """A counter of 16 bits begins anew where the field of a component is beyond its range; its counts are written down."""
    largest_T = np.abs(field_T).max(axis=1)
    count_T = (
        np.ceil(np.quantile(largest_T, rng.uniform(0.7, 0.95)) / HALF_OF_COUNTS / LEAST_COUNT_T)
        * LEAST_COUNT_T
    )
    counts = np.round(field_T / count_T)
    held = (counts + HALF_OF_COUNTS) % (2 * HALF_OF_COUNTS) - HALF_OF_COUNTS
    return held * count_T, np.flatnonzero((held != counts).any(axis=1))


def _exchanged_rows(field_T: Fields, rng: np.random.Generator) -> tuple[Fields, Rows]:
    """The fields of two rows, however far apart, are written down in each other's place."""
    pair = rng.choice(len(field_T), size=2, replace=False)
    field_T[pair] = field_T[pair[::-1]]
    return field_T, np.sort(pair)


def _stale_reading(field_T: Fields, rng: np.random.Generator) -> tuple[Fields, Rows]:
    """Each n-th reading is the one before: the sensor had no new one when it was asked."""
    rows = _every_nth(len(field_T), rng)
    field_T[rows] = field_T[rows - 1]
    return field_T, rows


class Placed(NamedTuple):
    """Places as they were written down, and the rows in which the sensor stood elsewhere."""

    place_m: Fields
    wrong: Rows


def placed(kind: str, place_m: Fields, rng: np.random.Generator) -> Placed:
    """A laboratory's table with one mistake in the columns of the places, in m."""
    changed, rows = (PLACES | LATER_PLACES)[kind](place_m.copy(), rng)
    return Placed(changed, rows[np.abs(changed - place_m)[rows].max(axis=1) > 0.0])


def _minus_lost(place_m: Fields, rng: np.random.Generator) -> tuple[Fields, Rows]:
    """One coordinate is typed without its sign, or with the wrong one, in some rows."""
    axis, rows = int(rng.integers(3)), _some(len(place_m), rng)
    place_m[rows, axis] *= -1.0
    return place_m, rows


def _decimal_point(place_m: Fields, rng: np.random.Generator) -> tuple[Fields, Rows]:
    """The decimal point of one coordinate is one place off in some rows."""
    axis, rows = int(rng.integers(3)), _some(len(place_m), rng)
    place_m[rows, axis] *= rng.choice([0.1, 10.0])
    return place_m, rows


def _other_order(place_m: Fields, rng: np.random.Generator) -> tuple[Fields, Rows]:
    """Two coordinates are typed in the other order for a while."""
    return _two_exchanged(place_m, rng)


def _stale_pose(place_m: Fields, rng: np.random.Generator) -> tuple[Fields, Rows]:
    """In each n-th row the pose is the one before: the arm had not told the new one yet."""
    rows = _every_nth(len(place_m), rng)
    place_m[rows] = place_m[rows - 1]
    return place_m, rows


def _late_pose(place_m: Fields, rng: np.random.Generator) -> tuple[Fields, Rows]:
    """For a while each pose is the one before."""
    rows = _a_while(len(place_m), rng)
    place_m[rows] = place_m[rows - 1].copy()
    return place_m, rows


def unsigned(field_T: Fields, current_A: Fields, rng: np.random.Generator) -> tuple[Fields, Fields, Rows]:
    """A relay reverses the current of a coil now and then, and the supply shows its size: fields, currents as written, and reversed rows.

    Args:
        field_T: As measured, of the coil alone.
        current_A: As delivered, by reading.
    """
    is_switched = rng.random(len(field_T)) < rng.uniform(0.3, 0.7)
    is_reversed = is_switched != (current_A < 0.0)
    return np.where(is_switched[:, None], -field_T, field_T), np.abs(current_A), np.flatnonzero(is_reversed)


def _two_exchanged(table: Fields, rng: np.random.Generator) -> tuple[Fields, Rows]:
    """Two columns of a table exchanged in a stretch of rows."""
    first, second = rng.choice(3, size=2, replace=False)
    rows = _a_while(len(table), rng)
    table[rows[:, None], [first, second]] = table[rows[:, None], [second, first]]
    return table, rows


def _some(n: int, rng: np.random.Generator) -> Rows:
    """One in thirty to one in seven rows, all over the session."""
    return np.flatnonzero(rng.random(n) < rng.uniform(0.03, 0.15))


def _every_nth(n: int, rng: np.random.Generator) -> Rows:
    """Each third to tenth row, from some row on."""
    step = int(rng.integers(3, 11))
    return np.arange(int(rng.integers(1, step + 1)), n, step)


def _a_while(n: int, rng: np.random.Generator) -> Rows:
    """A tenth to a quarter of the session."""
    length = int(rng.uniform(0.1, 0.25) * n)
    begin = int(rng.integers(1, n - length))
    return np.arange(begin, begin + length)


KINDS: dict[str, Callable[[Fields, np.random.Generator], tuple[Fields, Rows]]] = {
    "pasted": _pasted,
    "interpolated": _interpolated,
    "stale": _stale,
    "gauss": _gauss,
    "unsigned": _unsigned,
    "columns": _columns,
    "neighbour_row": _neighbour_row,
    "wrapped": _wrapped,
}
# Not among those that the study of statements draws from, whose seeds keep their meaning.
LATER_KINDS = {"exchanged_rows": _exchanged_rows, "stale_reading": _stale_reading}

PLACES: dict[str, Callable[[Fields, np.random.Generator], tuple[Fields, Rows]]] = {
    "minus_lost": _minus_lost,
    "decimal_point": _decimal_point,
    "other_order": _other_order,
}
LATER_PLACES = {"stale_pose": _stale_pose, "late_pose": _late_pose}
