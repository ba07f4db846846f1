"""Reads a CSV table whose header names carry their units. Lines that are no rows are left out and reported, each kind once.

`estimator.store.importers.table_readings` turns the table into observations.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from estimator.errors import CoilcalError, Faults, InvalidInput, cut
from estimator.store.importers.csv_lines import BadLine, Block, csv_blocks, row_of
from estimator.store.importers.table import (
    MOST_PLACES,
    SKIP,
    Cells,
    Column,
    HeaderCell,
    Table,
    fault_at,
    left_out,
    number_of,
)
from estimator.units import split_unit

EXPORT = "no line has: where commas are decimal signs too, export it with semicolons between cells"


def header_in(path: Path, known: Mapping[str, Column]) -> dict[str, HeaderCell] | None:
    """The cell of each quantity in the first line of a file; None where that is not the header of a readings CSV.

    Args:
        path: The file.
        known: Columns by quantity.
    """
    try:
        first = next(csv_blocks(path), None)
    except CoilcalError:
        return None
    row = row_of(first.texts[0], 1, ",") if first is not None and first.texts else []
    return None if isinstance(row, BadLine) else _header_of(row, known)


def _header_of(row: Sequence[str], known: Mapping[str, Column]) -> dict[str, HeaderCell] | None:
    """The header; None if a column is unknown, doubled, without its unit, or missing."""
    header: dict[str, HeaderCell] = {}
    for index, cell in enumerate(row):
        name = cell.strip()
        quantity, unit = (name, None) if name in known else split_unit(name)
        column, dimension = known.get(quantity), None if unit is None else unit.dimension
        if column is None or column.dimension != dimension or quantity in header:
            return None
        header[quantity] = HeaderCell(index, name, 1.0 if unit is None else unit.to_si)
    groups = {known[quantity].group for quantity in header}
    missing = (column for quantity, column in known.items() if quantity not in header and column.is_required)
    return None if any(column.group is None or column.group in groups for column in missing) else header


def read_table(
    path: Path,
    header: Mapping[str, HeaderCell],
    known: Mapping[str, Column],
    faults: Faults,
    skips_bad: bool = False,
) -> Table:
    """Read a table below its header.

    Args:
        path: Comma-separated UTF-8 text, one row on each line.
        header: Where each quantity stands, by the first line.
        known: Columns by quantity.
        faults: What becomes of faults.
        skips_bad: Leave out lines that are no rows, and rows with a fault.
    Raises:
        InvalidInput: The file cannot be read, a quote does not enclose a cell, a row has another length than the header, or there is no
            row.
    """
    blocks = csv_blocks(path)
    first = next(blocks)
    rows = without_headers(chain([first.rest(1)], blocks), first.texts[0])
    return filled_table(path, header, known, rows, len(header), faults, skips_bad)


def without_headers(blocks: Iterable[Block], header: str) -> Iterator[Block]:
    """Blocks without comments, and without lines that repeat the header, as logs have where a program was started again."""
    for block in blocks:
        if block.may_comment or header in block.texts:
            yield block.without(lambda text: text == header or text.lstrip().startswith("#"))
        else:
            yield block


def filled_table(
    path: Path,
    header: Mapping[str, HeaderCell],
    known: Mapping[str, Column],
    blocks: Iterable[Rows],
    width: int,
    faults: Faults,
    skips_bad: bool = False,
    plain: Callable[[Sequence[str]], Sequence[str]] | None = None,
) -> Table:
    """A table from the rows of a file.

    Args:
        path: The file, for messages.
        header: Where each quantity stands.
        known: Columns by quantity.
        blocks: Rows behind the header.
        width: Cells that a row must have.
        faults: What becomes of lines that are no rows.
        skips_bad: Leave them out, and rows with a fault.
        plain: Turns cells into numbers as Python writes them, where the file has others.
    Raises:
        InvalidInput: A line is no row, or there is none.
    """
    read = {quantity: _Reader(cell.column, known[quantity], plain) for quantity, cell in header.items()}
    lines: list[npt.NDArray[np.int64]] = []
    bad_lines: list[BadLine] = []
    for block in blocks:
        columns, numbers = block.columns(width, bad_lines)
        for reader in read.values():
            reader.add(columns[reader.column])
        lines.append(np.array(numbers, dtype=np.int64))
    line_of_row = np.concatenate(lines) if lines else np.zeros(0, dtype=np.int64)
    notes = _tell_bad_lines(path, bad_lines, faults, skips_bad, SKIP if len(line_of_row) else EXPORT)
    if not len(line_of_row) and not faults.noted:
        raise InvalidInput(f"{path} must hold at least one reading; it holds none")
    cells = {quantity: reader.cells() for quantity, reader in read.items()}
    return Table(path, header, cells, line_of_row, faults, skips_bad, notes=notes)


def _tell_bad_lines(
    path: Path, bad_lines: Sequence[BadLine], faults: Faults, skips_bad: bool, cure_of_all: str
) -> list[str]:
    """Note each kind of bad line once; where they are left out, say so."""
    alike: dict[str, list[BadLine]] = {}
    for bad in bad_lines:
        alike.setdefault(bad.rule, []).append(bad)
    notes = []
    for rule, group in alike.items():
        lines, received = [bad.number for bad in group], [bad.received for bad in group[:MOST_PLACES]]
        if skips_bad:
            notes.append(f"{left_out(lines, 'line')}: {rule}.")
            continue
        cure = ", or ".join(filter(None, (group[0].cure, cure_of_all)))
        faults.note(fault_at(path, lines, rule, received, cure, group[0].column))
    return notes


@runtime_checkable
class Rows(Protocol):
    """Some rows of a file."""

    def columns(self, width: int, bad_lines: list[BadLine]) -> tuple[Sequence[Sequence[str]], Sequence[int]]:
        """The cells by column, and the number of the line of each row; see `csv_lines.Block.columns`."""


class _Reader:
    """Reads one column, block by block."""

    def __init__(
        self, column: int, known: Column, plain: Callable[[Sequence[str]], Sequence[str]] | None = None
    ) -> None:
        self.column, self._is_number = column, known.dimension is not None
        self._plain = plain
        self._blocks: list[npt.NDArray[Any]] = []
        self._n_rows = 0
        self._refused: dict[int, str] = {}
        self._numbering = _Numbering()

    def add(self, cells: Sequence[str]) -> None:
        """Add the cells of some rows."""
        self._blocks.append(self._numbers(cells) if self._is_number else self._codes(cells))
        self._n_rows += len(cells)

    def cells(self) -> Cells:
        """All cells so far."""
        values = np.concatenate(self._blocks) if self._blocks else np.zeros(0)
        words = list(self._numbering)
        if self._is_number:
            return replace(Cells.of_numbers(values), refused=self._refused)
        return Cells(None, {}, words, values.astype(np.int32))

    def _codes(self, cells: Sequence[str]) -> npt.NDArray[np.int32]:
        stripped = map(str.strip, cells)
        return np.fromiter(map(self._numbering.__getitem__, stripped), dtype=np.int32, count=len(cells))

    def _numbers(self, cells: Sequence[str]) -> npt.NDArray[np.float64]:
        written = cells
        if self._plain is not None:
            cells = self._plain(cells)
        try:
            values = np.fromiter(map(float, cells), dtype=np.float64, count=len(cells))
            if np.isfinite(values).all() and "_" not in "".join(cells):
                return values
        except ValueError:
            pass
        values = np.fromiter(map(number_of, cells), dtype=np.float64, count=len(cells))
        for row in np.flatnonzero(np.isnan(values)).tolist():
            if text := written[row].strip():
                self._refused[self._n_rows + row] = cut(text)
        return values


class _Numbering(dict[str, int]):
    """Numbers of words in order of appearance."""

    def __missing__(self, word: str) -> int:
        self[word] = number = len(self)
        return number
