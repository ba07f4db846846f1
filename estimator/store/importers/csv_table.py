"""Reads a CSV table whose header names carry their units, and checks the header against the columns that a rig knows.

Where faults are collected, a row of another length is left out, and NaN or 0 stands for a cell that cannot be read.
`estimator.store.importers.readings_csv` turns the table into a session.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import torch
from jaxtyping import Float, Int

from estimator.errors import Faults, InvalidInput, Place, closest, nearest_name, reason
from estimator.store.importers.common import finite_number
from estimator.store.importers.other_headers import Known, meant
from estimator.units import UNITS, Unit, split_unit

UNKNOWN = "is not known to the rig"


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


@dataclass(frozen=True)
class Table:
    """The cells of a file by column, with header and line numbers for messages.

    Attributes:
        path: The file.
        header: Header cells by quantity.
        columns: Cells of each column.
        lines: Line number of each row.
        faults: What becomes of cells that cannot be read.
    """

    path: Path
    header: Mapping[str, HeaderCell]
    columns: Sequence[tuple[str, ...]]
    lines: Sequence[int]
    faults: Faults = field(default_factory=Faults)

    def __contains__(self, quantity: str) -> bool:
        return quantity in self.header

    def numbers(self, quantity: str, may_be_empty: bool = False) -> Float[torch.Tensor, " reading"]:
        """A column of numbers in SI; empty cells, if allowed, become NaN."""
        column, text, to_si = self.header[quantity]
        values = []
        for cell, line in zip(self.columns[column], self.lines, strict=True):
            value = math.nan
            if cell.strip() or not may_be_empty:
                try:
                    value = finite_number(cell, text, f"{self.path}, line {line}") * to_si
                except InvalidInput as fault:
                    self.faults.note(InvalidInput(str(fault), self.place(quantity, line)))
            values.append(value)
        return torch.tensor(values, dtype=torch.float64)

    def place(self, quantity: str, line: int) -> Place:
        """Location of a cell."""
        return Place(str(self.path), line, self.header[quantity].column + 1)

    def cells(self, quantity: str) -> list[tuple[str, int]]:
        """A column as it stands, each cell with its line; surrounding blanks are taken off."""
        column = self.header[quantity].column
        return [(cell.strip(), line) for cell, line in zip(self.columns[column], self.lines, strict=True)]

    def words(self, quantity: str, choices: Sequence[str]) -> Int[torch.Tensor, " reading"]:
        """A column of words, as indices into `choices`."""
        column, text, _ = self.header[quantity]
        index_of = {word: index for index, word in enumerate(choices)}
        indices = []
        for cell, line in zip(self.columns[column], self.lines, strict=True):
            word = cell.strip()
            if word not in index_of:
                received = f"{word!r}{closest(word, choices)}"
                words = f"{text} must be one of {', '.join(choices)}; received {received} ({self.path}, line {line})"
                self.faults.note(InvalidInput(words, self.place(quantity, line)))
            indices.append(index_of.get(word, 0))
        return torch.tensor(indices, dtype=torch.int64)


def read_table(path: Path, known: Mapping[str, Column], faults: Faults | None = None) -> Table:
    """Read a table and check its header.

    Args:
        path: Comma-separated UTF-8 text.
        known: Columns by quantity.
        faults: What becomes of faults; without it the first is raised. Columns at fault are left out.
    Raises:
        InvalidInput: The file cannot be read, a column is missing, unknown, doubled or without unit, a row has another length than the
            header, or there is no row.
    """
    rows: list[list[str]] = []
    lines: list[int] = []
    faults = faults or Faults()
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.reader(file)
            first_row = next(reader, [])
            second_row = next(reader, [])
            _refuse_other_separators(first_row, second_row, path)
            header = _header(first_row, known, path, faults)
            for row in chain([second_row], reader):
                if row and len(row) != len(first_row):
                    rule = f"a row must have {len(first_row)} cells like the header"
                    words = f"{rule}; received {len(row)} ({path}, line {reader.line_num})"
                    faults.note(InvalidInput(words, Place(str(path), reader.line_num)))
                elif row:
                    rows.append(row)
                    lines.append(reader.line_num)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InvalidInput(f"{path} must be readable as text: {reason(error)}") from error
    if not rows and not faults.noted:
        raise InvalidInput(f"{path} must hold at least one reading; it holds none")
    return Table(path, header, list(zip(*rows, strict=True)) or [()] * len(first_row), lines, faults)


def _refuse_other_separators(first_row: list[str], second_row: list[str], path: Path) -> None:
    """Say how to rewrite a file; one that has commas besides has them in its numbers."""
    line = ",".join(first_row)
    for separator, word, shown in ((";", "semicolons", ";"), ("\t", "tabs", "\\t")):
        if separator in line:
            how = f"rewrite it with: tr '{shown}' ',' < {path.name} > commas.csv"
            if len(second_row) > 1:  # split at commas, which are those of numbers
                how = f"rewrite it with: tr ',{shown}' '.,' < {path.name} > commas.csv"
            words = f"columns must be separated by commas; received {word}; {how} ({path}, line 1)"
            raise InvalidInput(words, Place(str(path), 1))


def _header(
    first_row: list[str], known: Mapping[str, Column], path: Path, faults: Faults
) -> dict[str, HeaderCell]:
    header: dict[str, HeaderCell] = {}
    are_names_told = False
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
    if missing := _missing(header, known, [cell.strip() for cell in first_row]):
        words = f"columns must include {', '.join(missing)}; the header lacks them ({path}, line 1)"
        faults.note(InvalidInput(words, Place(str(path), 1)))
    return header


def _header_fault(
    name: str, quantity: str, unit: Unit | None, known: Mapping[str, Column], header: Mapping[str, HeaderCell]
) -> str | None:
    """What is wrong with a cell of the header, given those before it."""
    column = known.get(quantity)
    if column is None or (unit is not None and column.dimension is None):
        if proposal := meant(name, _as_known(known)):
            return f"column {name!r} {UNKNOWN}; write {proposal}"
        alike = [each for each in known.values() if unit is None or each.dimension in {None, unit.dimension}]
        headers = {each.quantity: each.si_header for each in alike}
        nearest = nearest_name(quantity, headers)
        hint = closest(name, headers.values()) if nearest is None else f"; the closest is {headers[nearest]}"
        return f"column {name!r} {UNKNOWN}{hint}"
    if column.dimension is not None and unit is None:
        return f"column {name!r} lacks its unit: write {column.si_header}"
    if unit is not None and unit.dimension != column.dimension:
        return f"column {quantity!r} must be a {column.dimension}; received the unit {unit.symbol}"
    if quantity in header:
        return f"column {quantity!r} must be given once; received {header[quantity].text} and {name}"
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
