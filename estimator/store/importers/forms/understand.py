"""Reads a file of readings as it comes: finds layout and columns, says what it understood, and makes the table of them.

A file that is a readings CSV by its first line is read as such, at full speed and without a proposal.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, islice
from pathlib import Path

import numpy as np

from estimator.errors import CoilcalError, Faults, InvalidInput, Place
from estimator.readings.clock import Clock
from estimator.rig.rig import Rig
from estimator.store.importers.csv_header import csv_header
from estimator.store.importers.csv_lines import BadLine, Block, csv_blocks, row_of
from estimator.store.importers.csv_table import filled_table, read_table
from estimator.store.importers.forms.assignment import Assigned, Assignment, assigned_columns
from estimator.store.importers.forms.cells import is_number, plain_numbers
from estimator.store.importers.forms.encoding import encoding_of
from estimator.store.importers.forms.layout import (
    SAMPLE_LETTERS,
    SAMPLE_LINES,
    SEPARATORS,
    WORDS,
    Layout,
    Line,
    is_comment,
    layout_of,
)
from estimator.store.importers.forms.recipe import DECIMALS, NOTHING, SEPARATOR_OF, Recipe
from estimator.store.importers.forms.sources import CELL_SEPARATOR, MOST_COLUMNS, grid_of, kind_of, renumbered
from estimator.store.importers.forms.times import with_times
from estimator.store.importers.forms.units import split_file_unit
from estimator.store.importers.forms.wide import lengthened
from estimator.store.importers.readings_csv import columns_of, session_of, without_bad_rows
from estimator.store.importers.table import Cells, Column, HeaderCell, Table
from estimator.store.session import Session

LONGEST_LINE = 100_000  # characters: more columns than a file may have


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
        session: The readings.
        table: Their rows, with notes on what was left out.
        proposal: What was understood; None of a readings CSV.
    """

    session: Session
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
    if kind == "text" and recipe.is_plain and is_readings_csv(path, rig):
        table = read_table(path, columns_of(rig), faults, recipe.skips_bad)
        if not _has_other_numbers(table):
            table, session = session_of(table, rig, recipe.clock)
            return Understood(session, table, None)
    source = _text(path, recipe) if kind == "text" else _grid(path, kind, recipe)
    return _understood(source, rig, recipe, faults or Faults())


def understood_block(block: Block, rig: Rig, recipe: Recipe) -> Understood:
    """Read rows that stand in no file, their header first and their cells parted by `CELL_SEPARATOR`.

    Raises:
        InvalidInput: As in `understood`.
    """
    layout = layout_of(_lines(block.texts, block.numbers), (CELL_SEPARATOR,), ".")
    if layout is None:
        raise InvalidInput(f"{block.path} must have names of columns and rows of numbers; it has none")
    lines = tuple(_lines(block.texts, block.numbers))
    return _understood(Source(block.path, layout, "", "", lines, block, ()), rig, recipe, Faults())


def _understood(source: Source, rig: Rig, recipe: Recipe, faults: Faults) -> Understood:
    path, layout = source.path, source.layout
    if layout.width > MOST_COLUMNS:
        words = f"a file must have at most {MOST_COLUMNS} columns; received {layout.width}"
        raise InvalidInput(f"{words} ({path}, line {layout.first_line})", Place(str(path), layout.first_line))
    if layout.header is None:
        raise _no_header(path, layout, rig)
    place = Place(str(path), layout.header_line)
    assignment = assigned_columns(
        layout.header, layout.units, source.sample_rows(), rig, recipe, place, faults
    )
    table = _table(source, assignment, rig, recipe, faults)
    if faults.noted:
        _read_numbers(table)
        raise faults.noted.pop()  # whoever collects them notes it again
    created, table = with_times(table)
    has_time = "t" in table
    clock = recipe.clock if has_time else Clock.ROWS
    table = without_bad_rows(table)  # numbered as in the file, before rows of several sensors are
    table, session = session_of(lengthened(table, rig), rig, clock)
    if created:
        session = replace(session, created=created)
    remarks = (*source.remarks, *_remarks(assignment, recipe, has_time))
    whole = _whole_recipe(source, assignment, recipe, clock)
    return Understood(session, table, Proposal(assignment.assigned, remarks, whole))


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


def is_readings_csv(path: Path, rig: Rig) -> bool:
    """Whether the first line of a file is the header of a readings CSV of the rig."""
    try:
        first = next(csv_blocks(path), None)
        row = row_of(first.texts[0], 1, ",") if first is not None and first.texts else []
        if isinstance(row, BadLine):
            return False
        csv_header(row, columns_of(rig), path, Faults())
    except CoilcalError:
        return False
    return bool(row)


@dataclass(frozen=True)
class Source:
    """Rows of a file with their layout.

    Attributes:
        path: The file.
        layout: How its rows are read.
        encoding: Of a text; empty for others.
        sheet: Of a workbook; empty for others.
        lines: Its first lines.
        block: All rows of a file that is no text.
        remarks: Sentences on how it is read.
    """

    path: Path
    layout: Layout
    encoding: str
    sheet: str
    lines: tuple[Line, ...]
    block: Block | None
    remarks: tuple[str, ...]

    def rows(self) -> Iterator[Block]:
        """Rows behind the header, without comments and repeated headers."""
        blocks: Iterable[Block] = (
            csv_blocks(self.path, self.encoding, self.layout.separator)
            if self.block is None
            else [self.block]
        )
        headings = [line.text for line in self.lines if line.number < self.layout.first_line]
        repeated = frozenset(headings[-2:] if self.layout.units else headings[-1:])
        for block in blocks:
            if not block.texts or block.numbers[-1] < self.layout.first_line:
                continue
            rows = (
                block
                if block.numbers[0] >= self.layout.first_line
                else renumbered(block, self.layout.first_line)
            )
            if any(is_comment(text) or text in repeated for text in rows.texts):
                rows = rows.without(lambda text: is_comment(text) or text in repeated)
            yield rows

    def sample_rows(self) -> list[list[str]]:
        """Cells of some rows."""
        rows = []
        for line in self.lines:
            if line.number >= self.layout.first_line and not is_comment(line.text):
                row = row_of(line.text, line.number, self.layout.separator)
                if not isinstance(row, BadLine) and len(row) >= self.layout.width:
                    rows.append(row)
        return rows


def _text(path: Path, recipe: Recipe) -> Source:
    encoding = recipe.encoding or encoding_of(path)
    try:
        blocks = csv_blocks(path, encoding, None)
        first = next(blocks, Block(path, [], [], True))
    except LookupError:
        raise InvalidInput(
            f"encoding must be one that Python knows; received {encoding!r} ({path})"
        ) from None
    lines = _lines(first.texts, first.numbers)
    for line in lines:
        if len(line.text) > LONGEST_LINE:
            words = f"a line must have at most {LONGEST_LINE} characters; received {len(line.text)}"
            raise InvalidInput(
                f"{words} ({path}, line {line.number}): write one reading a line",
                Place(str(path), line.number),
            )
    separators = SEPARATORS if recipe.separator is None else (SEPARATOR_OF[recipe.separator],)
    decimals = ".," if recipe.decimal is None else DECIMALS[recipe.decimal]
    layout = layout_of(lines, separators, decimals)
    if layout is None:
        raise InvalidInput(
            f"{path} must hold a header and rows of numbers; no line holds two numbers between commas, semicolons, tabs or blanks"
        )
    if layout.is_unclear:
        raise InvalidInput(
            f"commas must be decimal signs or part thousands; both fit all numbers: say it with --decimal comma or --decimal point "
            f"({path}, line {layout.first_line})",
            Place(str(path), layout.first_line),
        )
    decimal = "decimal commas" if layout.decimal == "," else "decimal points"
    told = f"Text in {encoding.replace('_', '-')}, separated by {WORDS[layout.separator]}, with {decimal}"
    return Source(path, layout, encoding, "", tuple(lines), None, (told + _above(layout, lines),))


def _grid(path: Path, kind: str, recipe: Recipe) -> Source:
    def layout_in(block: Block) -> Layout | None:
        return layout_of(_lines(block.texts, block.numbers), (CELL_SEPARATOR,))

    grid = grid_of(path, kind, recipe.sheet, lambda block: layout_in(block) is not None)
    layout = layout_in(grid.block)
    if layout is None:
        raise InvalidInput(f"{path} must hold a header and rows of numbers; it holds none")
    lines = _lines(grid.block.texts, grid.block.numbers)
    told = f"Sheet {grid.name!r}" if kind == "workbook" else f"Arrays of one length in a file of kind {kind}"
    if grid.others:
        told += f" ({len(grid.others)} more are left out)"
    sheet = grid.name if kind == "workbook" else ""
    return Source(path, layout, "", sheet, tuple(lines), grid.block, (told + _above(layout, lines),))


def _lines(texts: Sequence[str], numbers: Sequence[int]) -> list[Line]:
    """The first lines, at least one, by which the layout is found."""
    lines, n_letters = list[Line](), 0
    for text, number in islice(zip(texts, numbers, strict=True), SAMPLE_LINES):
        lines.append(Line(number, text))
        n_letters += len(text)
        if n_letters > SAMPLE_LETTERS:
            break
    return lines


def _above(layout: Layout, lines: Sequence[Line]) -> str:
    """The end of a sentence on lines that are left out above the rows."""
    taken = layout.header_line
    n_above = sum(line.number < layout.first_line for line in lines) - 1 - bool(layout.units)
    above = (
        f"; {n_above} more {'line' if n_above == 1 else 'lines'} above the rows left out"
        if n_above > 0
        else ""
    )
    units = ", units in a line below" if layout.units else ""
    return f"; names of columns in line {taken}{units}{above}."


def _no_header(path: Path, layout: Layout, rig: Rig) -> InvalidInput:
    names = [column.si_header for column in columns_of(rig).values() if column.is_required]
    rule = f"the {layout.width} columns must have names"
    cure = f"put a line above that names each, such as {','.join(names[: layout.width])}"
    place = Place(str(path), layout.first_line)
    return InvalidInput(
        f"{rule}; no line above the numbers has them: {cure} ({path}, line {layout.first_line})", place
    )


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
    named = {each.header: each.name for each in assignment.assigned}
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
