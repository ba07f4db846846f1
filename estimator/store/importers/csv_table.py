"""Reads a CSV table whose header names carry their units, and checks the header against the columns that a rig knows.

Where faults are collected, a row of another length is left out, and NaN or 0 stands for a cell that cannot be read.
`estimator.store.importers.readings_csv` turns the table into a session.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from jaxtyping import Float, Int

from estimator.errors import Faults, InvalidInput, Place, closest, cut, nearest_name, quoted
from estimator.store.importers.csv_lines import Block, cells_of, csv_blocks
from estimator.store.importers.other_headers import Known, meant
from estimator.units import LARGEST, UNITS, Unit, split_unit

UNKNOWN = "is not known to the rig"
LONGEST_NAME = 200  # characters of a column that a rig may know
MOST_TOLD = 1000  # rows of a column whose fault is told one by one
MOST_FURTHER = 1000  # columns of a file beside those that the rig knows


@dataclass(frozen=True)
class Column:
    """A column that the rig knows.

    Attributes:
        quantity: Name of the column without its unit.
        dimension: Dimension of its unit; None for a column without unit.
        is_required: Whether the column must be there.
        group: Columns of a group may be missing only together.
    """

    quantity: str
    dimension: str | None = None
    is_required: bool = True
    group: str | None = None

    @property
    def si_header(self) -> str:
        """Header of the column in SI."""
        symbol = next((unit.symbol for unit in UNITS.values() if unit.dimension == self.dimension), None)
        return self.quantity if symbol is None else f"{self.quantity}_{symbol}"


class HeaderCell(NamedTuple):
    """A cell of the header: index of its column, its text, and the factor from its unit to SI."""

    column: int
    text: str
    to_si: float


@dataclass
class Cells:
    """One column: a number of each row, or a word of each row from a list, so that a million rows fit into memory.

    Attributes:
        numbers: Numbers as written; NaN where a cell is empty or no finite number. None for a column without dimension.
        refused: Cells that are neither empty nor a finite number, by row.
        words: Different cells of a column without dimension, in order of appearance.
        codes: Index of each row's cell among the words.
    """

    numbers: npt.NDArray[np.float64] | None
    refused: dict[int, str]
    words: list[str]
    codes: npt.NDArray[np.int32]


@dataclass(frozen=True)
class Table:
    """The cells of a file by column, with header and line numbers for messages.

    Attributes:
        path: The file.
        header: Header cells by quantity.
        columns: Cells by quantity.
        lines: Line number of each row.
        faults: What becomes of cells that cannot be read.
    """

    path: Path
    header: Mapping[str, HeaderCell]
    columns: Mapping[str, Cells]
    lines: npt.NDArray[np.int64]
    faults: Faults = field(default_factory=Faults)

    def __contains__(self, quantity: str) -> bool:
        return quantity in self.header

    def numbers(self, quantity: str, may_be_empty: bool = False) -> Float[torch.Tensor, " reading"]:
        """A column of numbers in SI; empty cells, if allowed, become NaN."""
        _, text, to_si = self.header[quantity]
        cells = self.columns[quantity]
        values, refused = cells.numbers, cells.refused
        if values is None:
            of_word = [_number(word) for word in cells.words]
            values = np.array(of_word, dtype=np.float64)[cells.codes]
            bad_words = [i for i, word in enumerate(cells.words) if word and np.isnan(of_word[i])]
            rows = np.flatnonzero(np.isin(cells.codes, bad_words))
            refused = {int(row): cells.words[cells.codes[row]] for row in rows}
        is_bad = np.zeros(len(values), dtype=bool)
        is_bad[list(refused)] = True
        if not may_be_empty:
            is_bad |= np.isnan(values)
        values = values * to_si
        is_beyond = np.abs(values) > LARGEST
        rule = f"{text} must be a finite number"
        self.refuse_rows(quantity, is_bad, lambda row: f"{rule}; received {quoted(refused.get(row, ''))}")
        if cells.numbers is not None:
            rule = f"{text} must lie between {-LARGEST / to_si:g} and {LARGEST / to_si:g}"
            self.refuse_rows(quantity, is_beyond, lambda row: f"{rule}; received {values[row] / to_si:.15g}")
        return torch.from_numpy(values)

    def refuse_rows(
        self,
        quantity: str | None,
        is_refused: npt.NDArray[np.bool_],
        words: Callable[[int], str],
        has_line: bool = False,
    ) -> None:
        """Note a fault for rows, the first `MOST_TOLD` one by one.

        Args:
            quantity: The column; None where the whole row is meant.
            is_refused: Whether a row is at fault.
            words: What is wrong with a row, without its place.
            has_line: Whether these words name the line themselves.
        """
        rows = np.flatnonzero(is_refused)
        column = None if quantity is None else self.header[quantity].column + 1
        for n_told, row in enumerate(rows[: MOST_TOLD + 1].tolist()):
            line = int(self.lines[row])
            told = words(row)
            if n_told == MOST_TOLD:
                told = f"{len(rows) - n_told} more rows from here on have a fault as those above"
            where = str(self.path) if has_line and n_told < MOST_TOLD else f"{self.path}, line {line}"
            self.faults.note(InvalidInput(f"{told} ({where})", Place(str(self.path), line, column)))

    def word_counts(self, quantity: str) -> dict[str, int]:
        """How often each word stands in a column of words, in order of appearance."""
        cells = self.columns[quantity]
        counts = np.bincount(cells.codes, minlength=len(cells.words)).tolist()
        return dict(zip(cells.words, counts, strict=True))

    def words(self, quantity: str, choices: Sequence[str]) -> Int[torch.Tensor, " reading"]:
        """A column of words, as indices into `choices`."""
        cells, text = self.columns[quantity], self.header[quantity].text
        index_of = {word: index for index, word in enumerate(choices)}
        rule = f"{text} must be one of {', '.join(choices)}"
        of_word = np.array([index_of.get(word, -1) for word in cells.words], dtype=np.int64)
        indices = of_word[cells.codes]

        def received(row: int) -> str:
            word = cells.words[cells.codes[row]]
            return f"{rule}; received {quoted(word)}{closest(cut(word), choices)}"

        self.refuse_rows(quantity, indices < 0, received)
        return torch.from_numpy(np.maximum(indices, 0))


def read_table(path: Path, known: Mapping[str, Column], faults: Faults | None = None) -> Table:
    """Read a table and check its header.

    Args:
        path: Comma-separated UTF-8 text, one row on each line.
        known: Columns by quantity.
        faults: What becomes of faults; without it the first is raised. Columns at fault are left out.
    Raises:
        InvalidInput: The file cannot be read, a column is missing, unknown, doubled or without unit, a quote does not enclose a cell, a
            row has another length than the header, or there is no row.
    """
    faults = faults or Faults()
    blocks = csv_blocks(path)
    first = next(blocks, Block(path, [], [], True))
    texts = [*first.texts[:2], "", ""]
    _refuse_other_separators(texts[0], texts[1], path)
    first_row = cells_of(texts[0], path, 1) if first.texts else []
    header = _header(first_row, known, path, faults)
    read = {quantity: _Reader(cell.column, known[quantity]) for quantity, cell in header.items()}
    lines: list[npt.NDArray[np.int64]] = []
    for block in chain([first.rest(1)], blocks):
        columns, numbers = block.columns(len(first_row), faults)
        for reader in read.values():
            reader.add(columns[reader.column])
        lines.append(np.array(numbers, dtype=np.int64))
    line_of_row = np.concatenate(lines)
    if not len(line_of_row) and not faults.noted:
        raise InvalidInput(f"{path} must hold at least one reading; it holds none")
    cells = {quantity: reader.cells() for quantity, reader in read.items()}
    return Table(path, header, cells, line_of_row, faults)


class _Reader:
    """Reads one column, block by block."""

    def __init__(self, column: int, known: Column) -> None:
        self.column, self._is_number = column, known.dimension is not None
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
        values = np.concatenate(self._blocks)
        words = list(self._numbering)
        if self._is_number:
            return Cells(values, self._refused, [], np.zeros(0, dtype=np.int32))
        return Cells(None, {}, words, values)

    def _codes(self, cells: Sequence[str]) -> npt.NDArray[np.int32]:
        stripped = map(str.strip, cells)
        return np.fromiter(map(self._numbering.__getitem__, stripped), dtype=np.int32, count=len(cells))

    def _numbers(self, cells: Sequence[str]) -> npt.NDArray[np.float64]:
        try:
            values = np.fromiter(map(float, cells), dtype=np.float64, count=len(cells))
            if np.isfinite(values).all() and "_" not in "".join(cells):
                return values
        except ValueError:
            pass
        values = np.fromiter(map(_number, cells), dtype=np.float64, count=len(cells))
        for row in np.flatnonzero(np.isnan(values)).tolist():
            if text := cells[row].strip():
                self._refused[self._n_rows + row] = cut(text)
        return values


class _Numbering(dict[str, int]):
    """Numbers of words in order of appearance."""

    def __missing__(self, word: str) -> int:
        self[word] = number = len(self)
        return number


def _number(cell: str) -> float:
    """A finite number as it is written; NaN for anything else."""
    try:
        value = float(cell)
    except ValueError:
        return math.nan
    # Python reads 1_000 as a thousand; no instrument writes that.
    return value if math.isfinite(value) and "_" not in cell else math.nan


def _refuse_other_separators(first: str, second: str, path: Path) -> None:
    """Say how to rewrite a file; one that has commas besides has them in its numbers."""
    for separator, word, shown in ((";", "semicolons", ";"), ("\t", "tabs", "\\t")):
        if separator in first:
            how = f"rewrite it with: tr '{shown}' ',' < {path.name} > commas.csv"
            if "," in second:
                how = f"rewrite it with: tr ',{shown}' '.,' < {path.name} > commas.csv"
            words = f"columns must be separated by commas; received {word}; {how} ({path}, line 1)"
            raise InvalidInput(words, Place(str(path), 1))


def _header(
    first_row: list[str], known: Mapping[str, Column], path: Path, faults: Faults
) -> dict[str, HeaderCell]:
    header: dict[str, HeaderCell] = {}
    are_names_told = False
    if len(first_row) > len(known) + MOST_FURTHER:
        words = f"a file must have at most {MOST_FURTHER} columns beside the {len(known)} that the rig knows"
        raise InvalidInput(f"{words}; received {len(first_row)} ({path}, line 1)", Place(str(path), 1))
    for index, cell in enumerate(first_row):
        name = cell.strip()
        quantity, unit = (name, None) if name in known else split_unit(name)
        fault = _header_fault(name, quantity, unit, known, header)
        if fault is not None and UNKNOWN in fault and not are_names_told:  # one list serves all
            fault = f"{fault}; known are {', '.join(column.si_header for column in known.values())}"
            are_names_told = True
        if fault is None:
            header[quantity] = HeaderCell(index, name, unit.to_si if unit else 1.0)
        else:
            faults.note(InvalidInput(f"{fault} ({path}, line 1)", Place(str(path), 1, index + 1)))
    names = [cell.strip() for cell in first_row]
    if missing := _missing(header, known, [name for name in names if len(name) <= LONGEST_NAME]):
        words = f"columns must include {', '.join(missing)}; the header lacks them ({path}, line 1)"
        faults.note(InvalidInput(words, Place(str(path), 1)))
    return header


def _header_fault(
    name: str, quantity: str, unit: Unit | None, known: Mapping[str, Column], header: Mapping[str, HeaderCell]
) -> str | None:
    """What is wrong with a cell of the header, given those before it."""
    if len(name) > LONGEST_NAME:
        return f"column {quoted(name)} {UNKNOWN}"
    column = known.get(quantity)
    if column is None or (unit is not None and column.dimension is None):
        if proposal := meant(name, _as_known(known)):
            return f"column {quoted(name)} {UNKNOWN}; write {proposal}"
        alike = [each for each in known.values() if unit is None or each.dimension in {None, unit.dimension}]
        headers = {each.quantity: each.si_header for each in alike}
        nearest = nearest_name(quantity, headers)
        hint = closest(name, headers.values()) if nearest is None else f"; the closest is {headers[nearest]}"
        return f"column {quoted(name)} {UNKNOWN}{hint}"
    if column.dimension is not None and unit is None:
        return f"column {quoted(name)} lacks its unit: write {column.si_header}"
    if unit is not None and unit.dimension != column.dimension:
        return f"column {quantity!r} must be a {column.dimension}; received the unit {unit.symbol}"
    if quantity in header:
        return (
            f"column {quantity!r} must be given once; received {cut(header[quantity].text)} and {cut(name)}"
        )
    return None


def _as_known(known: Mapping[str, Column]) -> dict[str, Known]:
    return {quantity: Known(column.dimension, column.is_required) for quantity, column in known.items()}


def _missing(header: Mapping[str, HeaderCell], known: Mapping[str, Column], raw: Sequence[str]) -> list[str]:
    """Columns that the header lacks; one that is written, though wrongly, is no second mistake."""
    written = [split_unit(name)[0] for name in raw]
    groups = {known[quantity].group for quantity in header}
    quantities = {column.si_header: quantity for quantity, column in known.items()}
    unknown = [name for name in written if name not in known]
    intended = {
        nearest_name(name, known) or quantities.get(nearest_name(name, quantities) or "") for name in unknown
    }
    proposed = {split_unit(meant(name, _as_known(known)) or "")[0] for name in raw}
    return [
        column.si_header
        for column in known.values()
        if column.is_required
        and column.quantity not in header
        and column.quantity not in written
        and column.quantity not in intended | proposed
        and (column.group is None or column.group in groups)
    ]
