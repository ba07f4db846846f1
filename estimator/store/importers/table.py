"""A table of readings by column, whatever file it came from, with the line of each row for messages.

NaN or 0 stands for a cell that cannot be read; faults of one kind are told once. Words that stand for a field that was not measured count
as empty cells.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from jaxtyping import Float, Int

from estimator.errors import Faults, InvalidInput, Place, closest, cut, listed, quoted
from estimator.tensors import Tensor, torch
from estimator.units import LARGEST, UNITS

MOST_PLACES = 3  # that a sentence lists


def fault_at(
    path: Path, lines: Sequence[int], rule: str, received: Sequence[str], cure: str, column: int | None = None
) -> InvalidInput:
    """One fault of one or several lines.

    Args:
        path: The file.
        lines: All lines that have it.
        rule: What they must be.
        received: What the first of them hold; empty words where the rule says it.
        cure: What to do about it; may be empty.
        column: The cell of the line.
    Examples:
        >>> print(fault_at(Path("a.csv"), [3], "t_s must be a number", ["'x'"], "correct it"))
        t_s must be a number; received 'x'; correct it (a.csv, line 3)
        >>> print(fault_at(Path("a.csv"), [3, 4, 9, 12], "t_s must be a number", ["'x'", "'y'", "'z'"], ""))
        t_s must be a number; received 'x' in line 3, 'y' in line 4, 'z' in line 9 and 1 more (a.csv, line 3)
    """
    verb = "" if not received[0] or " has " in received[0] or " holds " in received[0] else "received "
    if len(lines) == 1:
        told = f"{verb}{received[0]}"
    else:
        first = zip(received[:MOST_PLACES], lines, strict=False)
        told = verb + listed((f"{words} in line {line}".strip() for words, line in first), len(lines))
    parts = "; ".join(filter(None, (rule, told, cure)))
    return InvalidInput.at(Place(str(path), lines[0], column), parts)


def left_out(lines: Sequence[int], noun: str) -> str:
    """How many lines were left out, and which.

    Examples:
        >>> left_out([7], "line"), left_out([2, 3, 4, 9, 11], "row")
        ('1 line left out (line 7)', '5 rows left out (lines 2, 3, 4 and 2 more)')
    """
    shown = listed(map(str, lines[:MOST_PLACES]), len(lines))
    many = "" if len(lines) == 1 else "s"
    return f"{len(lines)} {noun}{many} left out (line{many} {shown})"


SKIP = "leave such lines out with --skip-bad-lines"
ZERO = "write 0 where no current flowed, for these readings tell the room's field from the coil's"
CONVERT = "convert the column, or name another one in its place with --column 'HEADER=NAME'"
OVERLOAD = 9e36  # SCPI instruments send 9.9e37 for an overload and 9.91e37 for no number
# Words of instruments and programs for a value that is missing, in lower case.
_WORDS = "nan na n/a #n/a #num! #value! null none nil - -- --- ---- ovld ol o.l. ovl ovf ovrng over overload overflow overrange"
_INFINITE = "inf +inf -inf infinity 1.#inf -1.#inf 1.#qnan -1.#qnan 1.#ind -1.#ind"
ABSENT = frozenset(f"{_WORDS} {_INFINITE}".split())


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

    @classmethod
    def of_numbers(cls, numbers: npt.NDArray[np.float64]) -> Cells:
        """Cells that hold numbers, NaN for empty ones."""
        return cls(numbers, {}, [], np.zeros(0, dtype=np.int32))

    def kept(self, is_kept: npt.NDArray[np.bool_]) -> Cells:
        """The cells of some rows."""
        if self.numbers is None:
            return replace(self, codes=self.codes[is_kept])
        new_row = np.cumsum(is_kept) - 1
        refused = {int(new_row[row]): text for row, text in self.refused.items() if is_kept[row]}
        return replace(self, numbers=self.numbers[is_kept], refused=refused)


@dataclass(frozen=True)
class Table:
    """The cells of a file by column, with header and line numbers for messages.

    Attributes:
        path: The file.
        header: Header cells by quantity.
        columns: Cells by quantity.
        lines: Line number of each row.
        faults: What becomes of cells that cannot be read.
        skips_bad: Whether rows with a fault are left out instead; `bad_rows` collects them.
        notes: Sentences on what was left out or counts as not measured.
    """

    path: Path
    header: Mapping[str, HeaderCell]
    columns: Mapping[str, Cells]
    lines: npt.NDArray[np.int64]
    faults: Faults = field(default_factory=Faults)
    skips_bad: bool = False
    bad_rows: set[int] = field(default_factory=set)
    notes: list[str] = field(default_factory=list)

    def __contains__(self, quantity: str) -> bool:
        return quantity in self.header

    def numbers(self, quantity: str, may_be_empty: bool = False) -> Float[Tensor, " reading"]:
        """A column of numbers in SI; empty cells and words for them, if allowed, become NaN."""
        _, text, to_si = self.header[quantity]
        values, refused = self._as_written(quantity)
        if may_be_empty:
            refused = {row: word for row, word in refused.items() if not is_absent(word)}
            values = np.where(np.abs(values) > OVERLOAD, np.nan, values)
        is_bad = np.zeros(len(values), dtype=bool)
        is_bad[list(refused)] = True
        if not may_be_empty:
            is_bad |= np.isnan(values)
        values = values * to_si
        rule = f"{text} must be a finite number"
        cure = f"{ZERO}, or {SKIP}" if quantity.endswith("_current") and not refused else SKIP
        self.refuse_rows(quantity, is_bad, rule, lambda row: quoted(refused.get(row, "")), cure)
        if self.columns[quantity].numbers is not None:
            rule = f"{text} must lie between {-LARGEST / to_si:g} and {LARGEST / to_si:g}"
            is_beyond = np.abs(values) > LARGEST
            self.refuse_rows(quantity, is_beyond, rule, lambda row: f"{values[row] / to_si:.15g}")
        return torch.from_numpy(values)

    def absent(self, quantity: str) -> dict[int, str]:
        """Words and overloads that stand for a number that is missing, by row."""
        values, refused = self._as_written(quantity)
        overloads = np.flatnonzero(np.abs(values) > OVERLOAD).tolist()
        words = {row: word for row, word in refused.items() if is_absent(word)}
        return words | {row: f"{values[row]:g}" for row in overloads}

    def is_nothing(self, quantity: str) -> npt.NDArray[np.bool_]:
        """Whether each row says that nothing was measured, by an empty cell or in words."""
        values, refused = self._as_written(quantity)
        is_nothing = np.isnan(values) | (np.abs(values) > OVERLOAD)
        is_nothing[[row for row, word in refused.items() if not is_absent(word)]] = False
        return is_nothing

    def _as_written(self, quantity: str) -> tuple[npt.NDArray[np.float64], dict[int, str]]:
        """A column of numbers as written, and its cells that are none."""
        cells = self.columns[quantity]
        if cells.numbers is not None:
            return cells.numbers, cells.refused
        of_word = [number_of(word) for word in cells.words]
        bad_words = [i for i, word in enumerate(cells.words) if word and np.isnan(of_word[i])]
        rows = np.flatnonzero(np.isin(cells.codes, bad_words))
        values = np.array(of_word, dtype=np.float64)[cells.codes]
        return values, {int(row): cells.words[cells.codes[row]] for row in rows}

    def without(self, rows: Collection[int]) -> Table:
        """The table without some rows."""
        is_kept = np.ones(len(self.lines), dtype=bool)
        is_kept[list(rows)] = False
        columns = {quantity: cells.kept(is_kept) for quantity, cells in self.columns.items()}
        return replace(self, columns=columns, lines=self.lines[is_kept], bad_rows=set())

    def refuse_rows(
        self,
        quantity: str,
        is_refused: npt.NDArray[np.bool_],
        rule: str,
        received: Callable[[int], str],
        cure: str = SKIP,
    ) -> None:
        """Note one fault of rows, with the first places and their number.

        Args:
            quantity: The column.
            is_refused: Whether a row is at fault.
            rule: What the cells must be.
            received: What stands in a row.
            cure: What to do where other rows are right.
        """
        rows = np.flatnonzero(is_refused).tolist()
        if self.skips_bad:
            self.bad_rows.update(rows)
        elif rows:
            column = self.header[quantity].column + 1 or None
            words = [received(row) for row in rows[:MOST_PLACES]]
            lines = [int(self.lines[row]) for row in rows]
            cure = cure if len(rows) < len(self.lines) else f"no row has: {CONVERT}"
            self.faults.note(fault_at(self.path, lines, rule, words, cure, column))

    def word_counts(self, quantity: str) -> dict[str, int]:
        """How often each word stands in a column of words, in order of appearance."""
        cells = self.columns[quantity]
        counts = np.bincount(cells.codes, minlength=len(cells.words)).tolist()
        return dict(zip(cells.words, counts, strict=True))

    def words(self, quantity: str, choices: Sequence[str]) -> Int[Tensor, " reading"]:
        """A column of words, as indices into `choices`."""
        cells, text = self.columns[quantity], self.header[quantity].text
        index_of = {word: index for index, word in enumerate(choices)}
        rule = f"{text} must be one of {', '.join(choices)}"
        of_word = np.array([index_of.get(word, -1) for word in cells.words], dtype=np.int64)
        indices = of_word[cells.codes]

        def received(row: int) -> str:
            word = cells.words[cells.codes[row]]
            return f"{quoted(word)}{closest(cut(word), choices)}"

        self.refuse_rows(quantity, indices < 0, rule, received)
        return torch.from_numpy(np.maximum(indices, 0))


def is_absent(word: str) -> bool:
    """Whether a cell says that nothing was measured.

    Examples:
        >>> [is_absent(word) for word in ("OVLD", "NaN", "-", "1,5", "x")]
        [True, True, True, False, False]
    """
    return word.strip().lower() in ABSENT


def number_of(cell: str) -> float:
    """A finite number as it is written; NaN for anything else."""
    try:
        value = float(cell)
    except ValueError:
        return math.nan
    # Python reads 1_000 as a thousand; no instrument writes that.
    return value if math.isfinite(value) and "_" not in cell else math.nan
