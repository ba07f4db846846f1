"""Reads a CSV table whose header names carry their units, and checks the header against the columns that a rig knows.

`estimator.store.importers.readings_csv` turns the table into a session.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import torch
from jaxtyping import Float, Int

from estimator.errors import InvalidInput, reason
from estimator.store.importers.common import finite_number
from estimator.units import UNITS, split_unit


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
    """

    path: Path
    header: Mapping[str, HeaderCell]
    columns: Sequence[tuple[str, ...]]
    lines: Sequence[int]

    def __contains__(self, quantity: str) -> bool:
        return quantity in self.header

    def numbers(self, quantity: str, may_be_empty: bool = False) -> Float[torch.Tensor, " reading"]:
        """A column of numbers in SI; empty cells, if allowed, become NaN."""
        column, text, to_si = self.header[quantity]
        values = [
            math.nan
            if may_be_empty and not cell.strip()
            else finite_number(cell, text, f"{self.path}, line {line}") * to_si
            for cell, line in zip(self.columns[column], self.lines, strict=True)
        ]
        return torch.tensor(values, dtype=torch.float64)

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
            if cell.strip() not in index_of:
                rule = f"{text} must be one of {', '.join(choices)}"
                raise InvalidInput(f"{rule}; received {cell.strip()!r} ({self.path}, line {line})")
            indices.append(index_of[cell.strip()])
        return torch.tensor(indices, dtype=torch.int64)


def read_table(path: Path, known: Mapping[str, Column]) -> Table:
    """Read a table and check its header.

    Args:
        path: Comma-separated UTF-8 text.
        known: Columns by quantity.
    Raises:
        InvalidInput: The file cannot be read, a column is missing, unknown, doubled or without unit, a row has another length than the
            header, or there is no row.
    """
    rows: list[list[str]] = []
    lines: list[int] = []
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.reader(file)
            first_row = next(reader, [])
            _refuse_other_separators(first_row, path)
            header = _header(first_row, known, path)
            for row in reader:
                if row and len(row) != len(first_row):
                    rule = f"a row must have {len(first_row)} cells like the header"
                    raise InvalidInput(f"{rule}; received {len(row)} ({path}, line {reader.line_num})")
                if row:
                    rows.append(row)
                    lines.append(reader.line_num)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InvalidInput(f"{path} must be readable as text: {reason(error)}") from error
    if not rows:
        raise InvalidInput(f"{path} must hold at least one reading; it holds none")
    return Table(path, header, list(zip(*rows, strict=True)), lines)


def _refuse_other_separators(first_row: list[str], path: Path) -> None:
    line = ",".join(first_row)
    for separator, word in ((";", "semicolons"), ("\t", "tabs")):
        if separator in line:
            raise InvalidInput(f"columns must be separated by commas; received {word} ({path}, line 1)")


def _header(first_row: list[str], known: Mapping[str, Column], path: Path) -> dict[str, HeaderCell]:
    header: dict[str, HeaderCell] = {}
    for index, cell in enumerate(first_row):
        name = cell.strip()
        quantity, unit = (name, None) if name in known else split_unit(name)
        column = known.get(quantity)
        if column is None or (unit is not None and column.dimension is None):
            names = ", ".join(column.si_header for column in known.values())
            raise InvalidInput(f"column {name!r} is not known to the rig; known are {names} ({path}, line 1)")
        if column.dimension is not None and unit is None:
            raise InvalidInput(f"column {name!r} lacks its unit: write {column.si_header} ({path}, line 1)")
        if unit is not None and unit.dimension != column.dimension:
            rule = f"column {quantity!r} must be a {column.dimension}"
            raise InvalidInput(f"{rule}; received the unit {unit.symbol} ({path}, line 1)")
        if quantity in header:
            rule = f"column {quantity!r} must be given once"
            raise InvalidInput(f"{rule}; received {header[quantity].text} and {name} ({path}, line 1)")
        header[quantity] = HeaderCell(index, name, unit.to_si if unit else 1.0)
    _refuse_missing(header, known, path)
    return header


def _refuse_missing(header: Mapping[str, HeaderCell], known: Mapping[str, Column], path: Path) -> None:
    groups = {known[quantity].group for quantity in header}
    missing = [
        column.si_header
        for column in known.values()
        if column.is_required
        and column.quantity not in header
        and (column.group is None or column.group in groups)
    ]
    if missing:
        raise InvalidInput(
            f"columns must include {', '.join(missing)}; the header lacks them ({path}, line 1)"
        )
