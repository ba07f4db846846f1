"""The readings CSV: one row per reading, header names that carry their unit; the table other people's scripts write.

Columns: `t_s, sensor, <coil>_current_A, <mover>_x_m .. _rz_rad` (or `<robot>_q0_rad .. _q5_rad`), `Bx_T, By_T, Bz_T`, and where wanted
`set` (calibration or validation), `repeat` and `<sensor or coil>_temperature_C`. Any unit of `estimator.units` may replace the SI one.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float, Int
from torch import Tensor

from estimator.errors import InvalidInput, reason
from estimator.readings.observations import Observations
from estimator.rig.rig import MotionKind, Mover, Rig
from estimator.store.importers.common import finite_number
from estimator.store.session import Session
from estimator.units import UNITS, split_unit

FIELD = ("Bx", "By", "Bz")
SETS = ("calibration", "validation")
LARGEST_REPEAT = 999_999_999


@dataclass(frozen=True)
class _Column:
    """One column the rig knows.

    Attributes:
        quantity: Its header without unit.
        dimension: Of its unit; None where it has none.
        group: Columns that may be missing only together.
    """

    quantity: str
    dimension: str | None = None
    is_required: bool = True
    group: str | None = None


@dataclass(frozen=True)
class _Table:
    """The cells of a file, column by column, with the header and the line numbers for messages.

    Attributes:
        place: Per quantity its column, its header as written and the factor of its unit to SI.
    """

    path: Path
    place: dict[str, tuple[int, str, float]]
    columns: list[tuple[str, ...]]
    lines: list[int]

    def __contains__(self, quantity: str) -> bool:
        return quantity in self.place

    def numbers(self, quantity: str, may_be_empty: bool = False) -> Float[Tensor, " reading"]:
        """One column in SI; NaN for empty cells where those are allowed."""
        column, header, to_si = self.place[quantity]
        values = [
            math.nan
            if may_be_empty and not cell.strip()
            else finite_number(cell, header, f"{self.path}, line {line}") * to_si
            for cell, line in zip(self.columns[column], self.lines, strict=True)
        ]
        return torch.tensor(values, dtype=torch.float64)

    def words(self, quantity: str, choices: Sequence[str]) -> Int[Tensor, " reading"]:
        """One column of words, as places in a list."""
        column, header, _ = self.place[quantity]
        index = {word: i for i, word in enumerate(choices)}
        found = []
        for cell, line in zip(self.columns[column], self.lines, strict=True):
            if cell.strip() not in index:
                rule = f"{header} must be one of {', '.join(choices)}"
                raise InvalidInput(f"{rule}; received {cell.strip()!r} ({self.path}, line {line})")
            found.append(index[cell.strip()])
        return torch.tensor(found, dtype=torch.int64)


def read_readings_csv(path: Path, rig: Rig) -> Session:
    """Read a readings CSV taken on a rig.

    Args:
        path: Comma-separated UTF-8 text. `sensor` may be left out where the rig has one; the three rotations of a mover that only
            translates may be left out together. An empty field cell is a component that was not measured.
        rig: Decides which columns there must be.
    Raises:
        InvalidInput: A column is missing, unknown, doubled or without unit; a cell is not what its column asks for; a sensor has two
            readings at one time. The message names file, line and column.
    """
    table = _read_table(path, _columns(rig))
    time_s = table.numbers("t")
    n = len(time_s)
    whole = torch.zeros(n, dtype=torch.int64)
    sensor = table.words("sensor", [s.name for s in rig.sensors]) if "sensor" in table else whole
    _refuse_doubles(table, time_s, sensor)
    bodies = [body.name for body in (*rig.coils, *rig.sensors)]
    observations = Observations(
        time_s,
        sensor,
        torch.stack([table.numbers(f"{coil.name}_current") for coil in rig.coils], dim=1),
        {mover.name: _motion(table, mover, n) for mover in rig.movers},
        _field(table),
        table.words("set", SETS).bool() if "set" in table else whole.bool(),
        _repeat(table) if "repeat" in table else whole,
        {b: table.numbers(f"{b}_temperature") for b in bodies if f"{b}_temperature" in table},
    )
    return Session(rig, observations, f"readings CSV {path.name}")


def write_readings_csv(session: Session, path: Path) -> None:
    """Write a session's readings in SI, with every digit: reading the file gives the same numbers back.

    Raises:
        InvalidInput: The file cannot be written.
    """
    rig, o = session.rig, session.observations
    names = [sensor.name for sensor in rig.sensors]
    columns: dict[str, Sequence[object]] = {
        "t_s": o.time_s.tolist(),
        "sensor": [names[i] for i in o.sensor.tolist()],
    }
    columns |= {f"{coil.name}_current_A": o.current_A[:, i].tolist() for i, coil in enumerate(rig.coils)}
    for mover in rig.movers:
        columns |= {name: o.motion[mover.name][:, i].tolist() for i, name in enumerate(mover.columns)}
    for i, name in enumerate(FIELD):
        columns[f"{name}_T"] = ["" if math.isnan(b) else b for b in o.field_sensor_T[:, i].tolist()]
    if o.is_validation.any():
        columns["set"] = [SETS[i] for i in o.is_validation.tolist()]
    if o.repeat.any():
        columns["repeat"] = o.repeat.tolist()
    columns |= {f"{name}_temperature_C": values.tolist() for name, values in o.temperature_C.items()}
    try:
        with path.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(columns)
            writer.writerows(zip(*columns.values(), strict=True))
    except OSError as error:
        raise InvalidInput(f"output must be writable; {path} is not: {reason(error)}") from error


def _columns(rig: Rig) -> dict[str, _Column]:
    columns = [_Column("t", "time"), _Column("sensor", is_required=len(rig.sensors) > 1)]
    columns += [_Column(f"{coil.name}_current", "current") for coil in rig.coils]
    for mover in rig.movers:
        for quantity, dimension in _mover_columns(mover):
            is_rotation = mover.motion in (MotionKind.POSE, MotionKind.DISPLACEMENT) and dimension == "angle"
            columns.append(
                _Column(quantity, dimension, group=f"{mover.name} rotation" if is_rotation else None)
            )
    columns += [_Column(name, "field") for name in FIELD]
    columns += [_Column("set", is_required=False), _Column("repeat", is_required=False)]
    for body in (*rig.coils, *rig.sensors):
        columns.append(_Column(f"{body.name}_temperature", "temperature", is_required=False))
    return {column.quantity: column for column in columns}


def _mover_columns(mover: Mover) -> Iterator[tuple[str, str]]:
    """Quantity and dimension of a mover's six columns."""
    for name in mover.columns:
        quantity, unit = split_unit(name)
        if unit is not None:
            yield quantity, unit.dimension


def _read_table(path: Path, known: dict[str, _Column]) -> _Table:
    rows: list[list[str]] = []
    lines: list[int] = []
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.reader(file)
            header = next(reader, [])
            _refuse_other_separators(header, path)
            place = _header(header, known, path)
            for row in reader:
                if row and len(row) != len(header):
                    rule = f"a row must have {len(header)} cells like the header"
                    raise InvalidInput(f"{rule}; received {len(row)} ({path}, line {reader.line_num})")
                if row:
                    rows.append(row)
                    lines.append(reader.line_num)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InvalidInput(f"{path} must be readable as text: {reason(error)}") from error
    if not rows:
        raise InvalidInput(f"{path} must hold at least one reading; it holds none")
    return _Table(path, place, list(zip(*rows, strict=True)), lines)


def _refuse_other_separators(header: list[str], path: Path) -> None:
    whole = ",".join(header)
    for separator, word in ((";", "semicolons"), ("\t", "tabs")):
        if separator in whole:
            raise InvalidInput(f"columns must be separated by commas; received {word} ({path}, line 1)")


def _header(header: list[str], known: dict[str, _Column], path: Path) -> dict[str, tuple[int, str, float]]:
    place: dict[str, tuple[int, str, float]] = {}
    for i, cell in enumerate(header):
        name = cell.strip()
        quantity, unit = (name, None) if name in known else split_unit(name)
        column = known.get(quantity)
        if column is None or (unit is not None and column.dimension is None):
            names = ", ".join(_written(c) for c in known.values())
            raise InvalidInput(f"column {name!r} is not known to the rig; known are {names} ({path}, line 1)")
        if column.dimension is not None and unit is None:
            raise InvalidInput(f"column {name!r} lacks its unit: write {_written(column)} ({path}, line 1)")
        if unit is not None and unit.dimension != column.dimension:
            rule = f"column {quantity!r} must be a {column.dimension}"
            raise InvalidInput(f"{rule}; received the unit {unit.symbol} ({path}, line 1)")
        if quantity in place:
            rule = f"column {quantity!r} must be given once"
            raise InvalidInput(f"{rule}; received {place[quantity][1]} and {name} ({path}, line 1)")
        place[quantity] = (i, name, unit.to_si if unit else 1.0)
    _refuse_missing(place, known, path)
    return place


def _refuse_missing(place: dict[str, tuple[int, str, float]], known: dict[str, _Column], path: Path) -> None:
    present = {known[quantity].group for quantity in place}
    missing = [
        _written(column)
        for column in known.values()
        if column.is_required
        and column.quantity not in place
        and (column.group is None or column.group in present)
    ]
    if missing:
        raise InvalidInput(
            f"columns must include {', '.join(missing)}; the header lacks them ({path}, line 1)"
        )


def _written(column: _Column) -> str:
    """The header of a column in SI."""
    symbol = next((unit.symbol for unit in UNITS.values() if unit.dimension == column.dimension), None)
    return column.quantity if symbol is None else f"{column.quantity}_{symbol}"


def _refuse_doubles(table: _Table, time_s: Tensor, sensor: Tensor) -> None:
    first: dict[tuple[float, int], int] = {}
    for key, line in zip(zip(time_s.tolist(), sensor.tolist(), strict=True), table.lines, strict=True):
        if key in first:
            rule = "a sensor must have one reading at a time"
            raise InvalidInput(
                f"{rule}; t_s = {key[0]:.15g} stands in lines {first[key]} and {line} ({table.path})"
            )
        first[key] = line


def _motion(table: _Table, mover: Mover, n: int) -> Float[Tensor, "reading 6"]:
    zero = torch.zeros(n, dtype=torch.float64)
    columns = [table.numbers(q) if q in table else zero for q, _ in _mover_columns(mover)]
    return torch.stack(columns, dim=1)


def _field(table: _Table) -> Float[Tensor, "reading 3"]:
    field_T = torch.stack([table.numbers(name, may_be_empty=True) for name in FIELD], dim=1)
    empty = torch.isnan(field_T).all(dim=1).nonzero().flatten()
    if len(empty):
        line = table.lines[int(empty[0])]
        raise InvalidInput(
            f"a row must have at least one field component; all three are empty ({table.path}, line {line})"
        )
    return field_T


def _repeat(table: _Table) -> Int[Tensor, " reading"]:
    values = table.numbers("repeat")
    wrong = ((values != values.floor()) | (values < 0) | (values > LARGEST_REPEAT)).nonzero().flatten()
    if len(wrong):
        row = int(wrong[0])
        rule = f"repeat must be a whole number from 0 to {LARGEST_REPEAT}"
        raise InvalidInput(f"{rule}; received {values[row]:.15g} ({table.path}, line {table.lines[row]})")
    return values.to(torch.int64)
