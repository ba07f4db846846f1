"""What was understood of a table, column by column, with its first rows in SI: for a terminal, and for a page that asks."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from string import digits

from estimator.errors import Faults, InvalidInput, Place, cut, in_order
from estimator.rig.rig import Rig
from estimator.store.importers.csv_lines import BadLine, row_of
from estimator.store.importers.forms.assigner import UNKNOWN_UNIT, Assigned, Assigner
from estimator.store.importers.forms.headings import targets_of
from estimator.store.importers.forms.recipe import AND, CLOCK, DATE, NOTHING, Recipe, together
from estimator.store.importers.forms.rows import Source, text_source
from estimator.store.importers.forms.understand import Understood, understood
from estimator.store.importers.table import Table
from estimator.units import UNITS

ROWS_SHOWN = 3
MOST_FAULTS = 8
LONGEST_CELL = 12
LONGEST_AS_WRITTEN = 22
MOST_SENSORS = 20  # whose rows one line of a file may hold


@dataclass(frozen=True)
class PreviewedColumn:
    """A column of a table.

    Attributes:
        header: As it stands in the file.
        name: What it is: a column of the readings CSV with its unit, `clock`, `date`, or `-` for one that is left out.
        values: Its first rows, in SI where it is read.
    """

    header: str
    name: str
    values: tuple[str, ...]


@dataclass(frozen=True)
class Preview:
    """What was understood of a table.

    Attributes:
        columns: All that it has; those that are read where it is a readings CSV.
        lines: Lines of the file that the first rows stand in.
        remarks: Sentences on what was assumed.
        names: What a column may be.
        n_readings: How many readings it holds; None where it cannot be read so.
        fault: Why it cannot, a line for each fault; empty where it can.
    """

    columns: tuple[PreviewedColumn, ...]
    lines: tuple[int, ...]
    remarks: tuple[str, ...]
    names: tuple[str, ...]
    n_readings: int | None
    fault: str = ""


def previewed(path: Path, rig: Rig, recipe: Recipe) -> Preview:
    """A text file of readings as it is understood, also where something of it has to be said before it can be read.

    Args:
        path: The file.
        rig: Determines what columns may be.
        recipe: What is known of the file.
    Raises:
        InvalidInput: No columns can be told apart.
    """
    names = names_of(rig)
    try:
        read = understood(path, rig, recipe)
    except InvalidInput:
        source = text_source(path, recipe)
        if source.layout.header is None:
            raise
        columns = _unread(source, recipe, _taken_for(source, rig, recipe))
        return Preview(columns, _lines_of(source), source.remarks, names, None, _faults_of(path, rig, recipe))
    lines = first_lines_of(read.table)
    n_readings = len(read.readings.observations)
    if read.proposal is None:
        columns = tuple(
            PreviewedColumn(cell.text, cell.text, _values(read.table, quantity, lines))
            for quantity, cell in read.table.header.items()
        )
        return Preview(columns, lines, (), names, n_readings)
    source = text_source(path, recipe)
    unread = {column.header: column for column in _unread(source, recipe, {})}
    assigned = {each.header: each for each in read.proposal.assigned}
    columns = tuple(
        replace(previewed_column(assigned[header], read), name=read.proposal.recipe.columns[header])
        if header in assigned
        else unread[header]
        for header in source.layout.header or ()
    )
    return Preview(columns, lines, read.proposal.remarks, names, n_readings)


def _faults_of(path: Path, rig: Rig, recipe: Recipe) -> str:
    """What is wrong with a table, a line for each fault, in their order."""
    faults = Faults(is_collected=True)
    with faults.noting():
        understood(path, rig, recipe, faults)
    sentences = [str(fault) for fault in in_order(faults.noted)]
    more = [f"and {len(sentences) - MOST_FAULTS} more"] if len(sentences) > MOST_FAULTS else []
    return "\n".join([*sentences[:MOST_FAULTS], *more])


def names_of(rig: Rig) -> tuple[str, ...]:
    """What a column may be in a table of a rig, each quantity in each unit that it may have."""
    names = [CLOCK, DATE]
    for target in targets_of(rig):
        if target.dimension is None:
            names.append(target.quantity)
        else:
            units = [unit.symbol for unit in UNITS.values() if unit.dimension == target.dimension]
            names += [f"{target.quantity}_{unit}" for unit in units]
    pairs = groupby((coil.name for coil in rig.coils), lambda name: name.rstrip(digits))
    for _, coils in pairs:  # such as x1 and x2, which may be in series
        if len(own := [f"{name}_current_A" for name in coils]) > 1:
            names.append(AND.join(own))
    return (NOTHING, *names)


def first_lines_of(table: Table) -> tuple[int, ...]:
    """Lines of the file that the first rows stand in."""
    return tuple(dict.fromkeys(table.lines[: ROWS_SHOWN * MOST_SENSORS].tolist()))[:ROWS_SHOWN]


def previewed_column(each: Assigned, read: Understood) -> PreviewedColumn:
    """A column that is read, with its first rows in SI."""
    quantity = "t" if each.quantity in {CLOCK, DATE} else each.quantity
    return PreviewedColumn(each.header, each.name, _values(read.table, quantity, first_lines_of(read.table)))


def _values(table: Table, quantity: str, lines: tuple[int, ...]) -> tuple[str, ...]:
    sensor, _, component = quantity.rpartition("_")
    own = component if component in {"Bx", "By", "Bz"} and component in table else quantity
    values = []
    for line in lines:
        rows = [i for i in range(min(len(table.lines), ROWS_SHOWN * MOST_SENSORS)) if table.lines[i] == line]
        if own != quantity:
            names = table.columns["sensor"]
            rows = [i for i in rows if names.words[names.codes[i]] == sensor]
        values.append(_shown(table, own, rows[0]) if rows and own in table else "")
    return tuple(values)


def _shown(table: Table, quantity: str, row: int) -> str:
    column, to_si = table.columns[quantity], table.header[quantity].to_si
    if column.numbers is None:
        return cut(column.words[column.codes[row]], LONGEST_CELL)
    value = column.numbers[row] * to_si
    return "-" if math.isnan(value) else f"{value:.6g} {si_symbol(quantity)}"


def si_symbol(quantity: str) -> str:
    """The SI unit of a column of readings, degrees Celsius for temperatures.

    Examples:
        >>> [si_symbol(name) for name in ("t", "coil1_current", "arm1_x", "arm1_rz", "ur_q0", "hall_Bx", "hall_temperature")]
        ['s', 'A', 'm', 'rad', 'rad', 'T', 'C']
    """
    last = quantity.rpartition("_")[2]
    ends = {"t": "s", "current": "A", "temperature": "C", "Bx": "T", "By": "T", "Bz": "T"}
    return ends.get(last, "m" if last in {"x", "y", "z"} else "rad")


def _lines_of(source: Source) -> tuple[int, ...]:
    numbers = [line.number for line in source.lines if line.number >= source.layout.first_line]
    return tuple(numbers[:ROWS_SHOWN])


def _taken_for(source: Source, rig: Rig, recipe: Recipe) -> dict[str, str]:
    """What the columns of a table are that lacks some."""
    layout, faults = source.layout, Faults(is_collected=True)
    place = Place(str(source.path), layout.header_line)
    assigner = Assigner(layout.header or (), layout.units, rig, recipe, place, faults)
    with faults.noting():
        assigner.give()
        assigner.find_clock(source.sample_rows())
        assigner.guess(source.sample_rows())
    return together((each.header, each.name) for each in assigner.assigned if each.unit is not UNKNOWN_UNIT)


def _unread(source: Source, recipe: Recipe, taken_for: Mapping[str, str]) -> tuple[PreviewedColumn, ...]:
    """All columns as they stand in the file, and what they are as far as that is known."""
    shown, known = set(_lines_of(source)), {**taken_for, **recipe.columns}
    cells = [
        row_of(line.text, line.number, source.layout.separator)
        for line in source.lines
        if line.number in shown
    ]
    rows = [[] if isinstance(row, BadLine) else row for row in cells]
    return tuple(
        PreviewedColumn(
            header,
            known.get(header, NOTHING),
            tuple(cut(row[number].strip(), LONGEST_AS_WRITTEN) if number < len(row) else "" for row in rows),
        )
        for number, header in enumerate(source.layout.header or ())
    )
