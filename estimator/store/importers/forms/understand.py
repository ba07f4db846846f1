"""Reads a file of readings as it comes: finds layout and columns, says what it understood, and makes the table of them.

A file that is a readings CSV by its first line is read as such, at full speed and without a proposal.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain, islice
from pathlib import Path

import numpy as np

from estimator.errors import Faults, InvalidInput, Place
from estimator.readings.clock import Clock
from estimator.rig.rig import Rig
from estimator.store.importers.csv_lines import Block
from estimator.store.importers.csv_table import filled_table, header_in, read_table
from estimator.store.importers.forms.assigner import Assigned, Assigner
from estimator.store.importers.forms.cells import is_number, plain_numbers
from estimator.store.importers.forms.layout import SAMPLE_LINES, WORDS, Layout, layout_of
from estimator.store.importers.forms.missing import check_missing
from estimator.store.importers.forms.recipe import DECIMALS, NOTHING, Recipe, together
from estimator.store.importers.forms.rows import Source, first_lines, grid_source, text_source
from estimator.store.importers.forms.sources import CELL_SEPARATOR, MOST_COLUMNS, kind_of
from estimator.store.importers.forms.times import with_times
from estimator.store.importers.forms.units import split_file_unit
from estimator.store.importers.forms.wide import lengthened
from estimator.store.importers.table import Cells, Column, HeaderCell, Table
from estimator.store.importers.table_readings import Recorded, columns_of, readings_of, without_bad_rows


@dataclass(frozen=True)
class Proposal:
    """What was understood of a file that is no readings CSV.

    Attributes:
        assigned: Columns that are read, in the order of the file.
        remarks: Sentences on what was assumed.
        recipe: All of it, to be used again.
    """

    assigned: tuple[Assigned, ...]
    remarks: tuple[str, ...]
    recipe: Recipe


@dataclass(frozen=True)
class Understood:
    """Readings of a file.

    Attributes:
        readings: The readings, with their source and time.
        table: Their rows, with notes on what was left out.
        proposal: What was understood; None of a readings CSV.
    """

    readings: Recorded
    table: Table
    proposal: Proposal | None


def understood(
    path: Path, rig: Rig, recipe: Recipe | None = None, faults: Faults | None = None
) -> Understood:
    """Read a file of readings in whatever form.

    Args:
        path: Text, workbook, HDF5, MATLAB, NumPy or Parquet.
        rig: Determines the columns.
        recipe: What is known of the file; the rest is found in it.
        faults: What becomes of faults of rows; without it the first is raised.
    Raises:
        InvalidInput: It cannot be read or understood; the sentence says what to do.
    """
    recipe = recipe or Recipe()
    kind = kind_of(path)
    known = columns_of(rig)
    if kind == "text" and recipe.is_plain and (header := header_in(path, known)) is not None:
        table = read_table(path, header, known, faults or Faults(), recipe.skips_bad)
        if not _has_other_numbers(table):
            table, readings = readings_of(table, rig, recipe.clock)
            return Understood(readings, table, None)
    source = text_source(path, recipe) if kind == "text" else grid_source(path, kind, recipe)
    return _understood(source, rig, recipe, faults or Faults())


def understood_block(block: Block, rig: Rig, recipe: Recipe) -> Understood:
    """Read rows that stand in no file, their header first and their cells parted by `CELL_SEPARATOR`.

    Raises:
        InvalidInput: As in `understood`.
    """
    layout = layout_of(first_lines(block.texts, block.numbers), (CELL_SEPARATOR,), ".")
    if layout is None:
        raise InvalidInput(f"{block.path} must have names of columns and rows of numbers; it has none")
    lines = tuple(first_lines(block.texts, block.numbers))
    return _understood(Source(block.path, layout, "", "", lines, block, ()), rig, recipe, Faults())


def _understood(source: Source, rig: Rig, recipe: Recipe, faults: Faults) -> Understood:
    path, layout = source.path, source.layout
    if layout.width > MOST_COLUMNS:
        words = f"a file must have at most {MOST_COLUMNS} columns; received {layout.width}"
        raise InvalidInput.at(Place(str(path), layout.first_line), words)
    if layout.header is None:
        raise _no_header(path, layout, rig)
    place = Place(str(path), layout.header_line)
    assignment = assigned_columns(
        layout.header, layout.units, source.sample_rows(), rig, recipe, place, faults
    )
    table = _table(source, assignment, rig, recipe, faults)
    if faults.noted:
        _read_numbers(table)
        raise faults.noted.pop()  # a caller that collects faults notes it again
    created, table = with_times(table)
    has_time = "t" in table
    clock = recipe.clock if has_time else Clock.ROWS
    table = without_bad_rows(table)  # numbered as in the file, before rows of several sensors are
    table, readings = readings_of(lengthened(table, rig), rig, clock)
    if created:
        readings = readings._replace(created=created)
    remarks = (*source.remarks, *_remarks(assignment, recipe, has_time))
    whole = _whole_recipe(source, assignment, recipe, clock)
    return Understood(readings, table, Proposal(assignment.assigned, remarks, whole))


def _read_numbers(table: Table) -> None:
    """Read the numbers of a table that lacks columns, for their faults alone."""
    for quantity, cells in table.columns.items():
        if cells.numbers is not None:
            table.numbers(quantity, may_be_empty=quantity.endswith(("Bx", "By", "Bz")))


def _has_other_numbers(table: Table) -> bool:
    """Whether cells hold numbers with decimal commas or thousands."""
    cells = [
        text for column in table.columns.values() for text in islice(column.refused.values(), SAMPLE_LINES)
    ]
    return any(is_number(text, decimal) for text in cells for decimal in DECIMALS.values())


def _no_header(path: Path, layout: Layout, rig: Rig) -> InvalidInput:
    names = [
        column.si_header for column in columns_of(rig).values() if column.is_required and not column.group
    ]
    rule = f"the {layout.width} columns must have names"
    cure = f"put a line above that names each with its unit, out of {', '.join(names)}, or - where coilcal has no use for it"
    place = Place(str(path), layout.first_line)
    return InvalidInput.at(place, f"{rule}; no line above the numbers has them: {cure}")


def _table(source: Source, assignment: Assignment, rig: Rig, recipe: Recipe, faults: Faults) -> Table:
    known = dict(columns_of(rig))
    header: dict[str, HeaderCell] = {}
    for each in assignment.assigned:
        dimension = None if each.unit is None else each.unit.dimension
        known[each.quantity] = Column(each.quantity, dimension)
        header[each.quantity] = HeaderCell(
            each.column, each.header, 1.0 if each.unit is None else each.unit.to_si
        )
    plain = plain_numbers(source.layout.decimal)
    table = filled_table(
        source.path, header, known, source.rows(), source.layout.width, faults, recipe.skips_bad, plain
    )
    columns, header = dict(table.columns), dict(table.header)
    for each in assignment.assigned:
        if each.unit is not None and each.unit.offset_si:
            numbers = columns[each.quantity].numbers
            assert numbers is not None
            columns[each.quantity] = replace(
                columns[each.quantity], numbers=numbers * each.unit.to_si + each.unit.offset_si
            )
            header[each.quantity] = header[each.quantity]._replace(to_si=1.0)
    for name, value in recipe.constants.items():
        quantity, unit = split_file_unit(name)
        if unit is None or quantity not in columns_of(rig):
            raise InvalidInput(
                f"constants must be columns that the rig knows, with a unit; received {name} ({source.path})"
            )
        if quantity in header:
            raise InvalidInput(
                f"{quantity} must be given once; the file has it, and a constant too ({source.path})"
            )
        header[quantity] = HeaderCell(-1, name, unit.to_si)
        columns[quantity] = Cells.of_numbers(np.full(len(table.lines), float(value)))
    return replace(table, header=header, columns=columns)


def _remarks(assignment: Assignment, recipe: Recipe, has_time: bool) -> list[str]:
    told = []
    if assignment.left_out:
        told.append(f"Left out: {', '.join(assignment.left_out)}.")
    fields = {each.quantity[-2:] for each in assignment.assigned if each.quantity[-2:] in {"Bx", "By", "Bz"}}
    if missing := [name for name in ("Bx", "By", "Bz") if name not in fields]:
        told.append(f"Not measured: {', '.join(missing)}.")
    if recipe.constants:
        told.append(
            f"The same in all rows: {', '.join(f'{name} = {v:g}' for name, v in recipe.constants.items())}."
        )
    if not has_time:
        told.append("No time: rows count as one second each.")
    return told


def _whole_recipe(source: Source, assignment: Assignment, recipe: Recipe, clock: Clock) -> Recipe:
    named = together((each.header, each.name) for each in assignment.assigned)
    left = dict.fromkeys(assignment.left_out, NOTHING)
    is_text = source.block is None
    decimal = next(word for word, sign in DECIMALS.items() if sign == source.layout.decimal)
    return replace(
        recipe,
        columns=dict(chain(named.items(), left.items())),
        separator=WORDS[source.layout.separator] if is_text else None,
        decimal=decimal if is_text else None,
        encoding=source.encoding or None,
        sheet=source.sheet or None,
        clock=clock,
        is_whole=True,
    )


@dataclass(frozen=True)
class Assignment:
    """Which columns are read as what.

    Attributes:
        assigned: Columns that are read.
        left_out: Headers of the others.
    """

    assigned: tuple[Assigned, ...]
    left_out: tuple[str, ...]


def assigned_columns(
    header: Sequence[str],
    units: Sequence[str],
    cells: Sequence[Sequence[str]],
    rig: Rig,
    recipe: Recipe,
    place: Place,
    faults: Faults,
) -> Assignment:
    """Which column is which quantity.

    Args:
        header: Names of the columns.
        units: Their units, where a line of its own has them.
        cells: Some rows.
        rig: Determines the quantities.
        recipe: What is known beforehand.
        place: Of the header, for messages.
        faults: What becomes of faults; columns at fault are left out.
    Raises:
        InvalidInput: A quantity is missing, may be one of several columns, or has no known unit; the sentence says what to do.
    """
    assigner = Assigner(header, units, rig, recipe, place, faults)
    assigner.give()
    if not recipe.is_whole:
        assigner.find_clock(cells)
        assigner.guess(cells)
    assigned = tuple(sorted(assigner.assigned, key=lambda each: each.column))
    check_missing(assigner, {each.quantity for each in assigned} | assigner.refused)
    read = {each.column for each in assigned}
    left = [heading.text.strip() for i, heading in enumerate(assigner.headings) if i not in read]
    return Assignment(assigned, tuple(name for name in left if name))
