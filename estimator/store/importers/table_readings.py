"""Turns a table of readings into observations in SI, by the columns that a rig knows."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from jaxtyping import Float, Int

from estimator.errors import InvalidInput, Place, listed, quoted
from estimator.readings.clock import Clock, jumps_back, now, read_clock
from estimator.readings.observations import Observations
from estimator.readings.segments import NO_SEGMENT
from estimator.rig.bodies import MotionKind, Mover
from estimator.rig.rig import Rig
from estimator.store.importers.common import moment
from estimator.store.importers.table import MOST_PLACES, Column, Table, left_out
from estimator.tensors import Tensor, torch
from estimator.units import split_unit

FIELD = ("Bx", "By", "Bz")
SETS = ("calibration", "validation")
LARGEST_NUMBER = 999_999_999  # of repeats and segments


class Recorded(NamedTuple):
    """Readings with what their file says of them, in the order in which a `Session` takes them.

    Attributes:
        observations: The readings.
        source: Origin of the readings, in words.
        created: ISO date and time at which they were taken; the present time where the file does not say.
    """

    observations: Observations
    source: str
    created: str


class ReadTable(NamedTuple):
    """Readings and the rows of the table that they were made of."""

    table: Table
    readings: Recorded


def readings_of(table: Table, rig: Rig, clock: Clock = Clock.AS_WRITTEN) -> ReadTable:
    """The readings of a table, and its rows; rows without a field are left out, and those with a fault where the table says so.

    Raises:
        InvalidInput: A cell has another type than its column, a sensor has two readings at one time, or no row is left.
    """
    table = _with_fields(table)
    readings = _readings(table, rig, clock)
    while table.bad_rows:
        table = without_bad_rows(table)
        readings = _readings(table, rig, clock)
    return ReadTable(table, readings)


def without_bad_rows(table: Table) -> Table:
    """The table without rows that were found to have a fault, with a note.

    Raises:
        InvalidInput: No row is left.
    """
    if not table.bad_rows:
        return table
    bad_rows = sorted(table.bad_rows)
    told = left_out([int(table.lines[row]) for row in bad_rows], "row")
    table.notes.append(f"{told}: a cell has a fault.")
    return _not_empty(table.without(bad_rows))


def _with_fields(table: Table) -> Table:
    """The table without rows that hold no field, and a note on cells that say so in words."""
    names = [name for name in FIELD if name in table]
    words = {(row, name): word for name in names for row, word in table.absent(name).items()}
    if words:
        first = sorted(words)[:MOST_PLACES]
        shown = listed((f"{words[key]} in line {table.lines[key[0]]}" for key in first), len(words))
        many = "cells of fields count" if len(words) > 1 else "cell of a field counts"
        table.notes.append(f"{len(words)} {many} as not measured: {shown}.")
    empty = np.ones(len(table.lines), dtype=bool)
    for name in names:
        empty &= table.is_nothing(name)
    rows = np.flatnonzero(empty).tolist()
    if not rows or not names:
        return table
    told = left_out([int(table.lines[row]) for row in rows], "row")
    table.notes.append(f"{told}: no component of the field was measured.")
    return _not_empty(table.without(rows))


def _not_empty(table: Table) -> Table:
    if not len(table.lines):
        raise InvalidInput(f"{table.path} must hold at least one reading; all its rows were left out")
    return table


def _readings(table: Table, rig: Rig, clock: Clock) -> Recorded:
    n = len(table.lines)
    zeros = torch.zeros(n, dtype=torch.int64)
    sensor = table.words("sensor", [s.name for s in rig.sensors]) if "sensor" in table else zeros
    time_s = torch.from_numpy(read_clock(_times(table), sensor.numpy(), clock))
    _refuse_doubles(table, time_s, sensor)
    bodies = [body.name for body in (*rig.coils, *rig.sensors)]
    segment, labels = _segment(table) if "segment" in table else (None, {})
    observations = Observations(
        time_s,
        sensor,
        torch.stack([table.numbers(f"{coil.name}_current") for coil in rig.coils], dim=1),
        {mover.name: _motion(table, mover, n) for mover in rig.movers},
        _field(table),
        table.words("set", SETS).bool() if "set" in table else zeros.bool(),
        _whole(table, "repeat") if "repeat" in table else zeros,
        {b: table.numbers(f"{b}_temperature") for b in bodies if f"{b}_temperature" in table},
        recorded_segment=segment,
        line=torch.from_numpy(table.lines.astype(np.int64)),
    )
    named = "".join(f"; segment {number} is {label}" for label, number in labels.items())
    created = _recorded_at(table) if "recorded_at" in table else now()
    return Recorded(observations, f"readings CSV {table.path.name}{named}", created)


def _times(table: Table) -> npt.NDArray[np.float64]:
    """Times as written; the number of the row where there are none, which only `Clock.ROWS` reads."""
    if "t" not in table:
        return np.arange(len(table.lines), dtype=np.float64)
    return table.numbers("t").numpy()


def columns_of(rig: Rig) -> dict[str, Column]:
    """Columns that a rig knows, by quantity."""
    columns = [Column("t", "time"), Column("sensor", is_required=len(rig.sensors) > 1)]
    columns += [Column(f"{coil.name}_current", "current") for coil in rig.coils]
    for mover in rig.movers:
        for quantity, dimension in _mover_columns(mover):
            is_rotation = mover.motion in (MotionKind.POSE, MotionKind.DISPLACEMENT) and dimension == "angle"
            columns.append(
                Column(quantity, dimension, group=f"{mover.name} rotation" if is_rotation else None)
            )
    columns += [Column(name, "field") for name in FIELD]
    columns += [Column(name, is_required=False) for name in ("set", "repeat", "segment", "recorded_at")]
    for body in (*rig.coils, *rig.sensors):
        columns.append(Column(f"{body.name}_temperature", "temperature", is_required=False))
    return {column.quantity: column for column in columns}


def _mover_columns(mover: Mover) -> Iterator[tuple[str, str]]:
    """Quantity and dimension of a mover's six columns."""
    for name in mover.columns:
        quantity, unit = split_unit(name)
        if unit is not None:
            yield quantity, unit.dimension


def _recorded_at(table: Table) -> str:
    """The earliest date and time in the column; cells may be empty, but not all."""
    cells = table.columns["recorded_at"]
    if not any(cells.words):
        raise InvalidInput(f"recorded_at must hold a date in some line; it holds none ({table.path})")
    moments, refusals = [], list[int]()
    for code, word in enumerate(cells.words):
        try:
            if word:
                moments.append(moment(word, "recorded_at"))
        except InvalidInput:
            refusals.append(code)
    is_refused = np.isin(cells.codes, refusals)
    rule = "recorded_at must be a date such as 2026-03-01 or 2026-03-01T09:30+01:00, and not in the future"
    table.refuse_rows("recorded_at", is_refused, rule, lambda row: quoted(cells.words[int(cells.codes[row])]))
    return min(moments, default="")


def _refuse_doubles(table: Table, time_s: Tensor, sensor: Tensor) -> None:
    """Refuse a reading at the time of an earlier one of its sensor; a time that is no number was refused before."""
    order = np.lexsort((np.arange(len(time_s)), sensor.numpy(), time_s.numpy()))
    own_s, own = time_s.numpy()[order], sensor.numpy()[order]
    is_new = np.ones(len(order), dtype=bool)
    is_new[1:] = (own_s[1:] != own_s[:-1]) | (own[1:] != own[:-1])
    first = order[np.maximum.accumulate(np.where(is_new, np.arange(len(order)), 0))]
    first_of_row, is_double = np.empty_like(order), np.empty_like(is_new)
    first_of_row[order], is_double[order] = first, ~is_new

    rows = np.flatnonzero(is_double).tolist()
    if table.skips_bad:
        table.bad_rows.update(rows)
    elif rows:
        doubled = (
            f"t_s = {float(time_s[row]):.15g} is in lines {table.lines[first_of_row[row]]} and {table.lines[row]}"
            for row in rows[:MOST_PLACES]
        )
        told = listed(doubled, len(rows))
        back = jumps_back(time_s.numpy(), sensor.numpy())
        cure = "share stamps out with --clock spread"
        if back:
            cure = f"time jumps back in line {table.lines[back[0]]}: go on behind it with --clock continue"
        words = f"a sensor must have one reading at a time; {told}; {cure}"
        place = Place(str(table.path), int(table.lines[rows[0]]), table.header["t"].column + 1)
        table.faults.note(InvalidInput.at(place, words))


def _motion(table: Table, mover: Mover, n: int) -> Float[Tensor, "reading 6"]:
    zero = torch.zeros(n, dtype=torch.float64)
    columns = [table.numbers(q) if q in table else zero for q, _ in _mover_columns(mover)]
    return torch.stack(columns, dim=1)


def _field(table: Table) -> Float[Tensor, "reading 3"]:
    nothing = torch.full((len(table.lines),), torch.nan, dtype=torch.float64)
    columns = [table.numbers(name, may_be_empty=True) if name in table else nothing for name in FIELD]
    return torch.stack(columns, dim=1)


def _segment(table: Table) -> tuple[Int[Tensor, " reading"], dict[str, int]]:
    """Number of each row's segment, `NO_SEGMENT` for an empty cell; labels that are no numbers get theirs in order of appearance."""
    cells = table.columns["segment"]
    labels = [word for word in cells.words if word]
    if all(label.isdecimal() for label in labels):
        return _whole(table, "segment", may_be_empty=True), {}
    number_of = {label: i for i, label in enumerate(labels)}
    of_word = np.array([number_of.get(word, NO_SEGMENT) for word in cells.words])
    return torch.from_numpy(of_word[cells.codes]), number_of


def _whole(table: Table, name: str, may_be_empty: bool = False) -> Int[Tensor, " reading"]:
    """A column of whole numbers; -1 for a cell that may be empty."""
    values = table.numbers(name, may_be_empty)
    bad_rows = ((values != values.floor()) | (values < 0) | (values > LARGEST_NUMBER)) & ~values.isnan()
    rule = f"{name} must be a whole number from 0 to {LARGEST_NUMBER}"
    table.refuse_rows(name, bad_rows.numpy(), rule, lambda row: f"{values[row]:.15g}")
    return values.nan_to_num(nan=NO_SEGMENT).to(torch.int64)
