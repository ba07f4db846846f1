"""Lines of a CSV file as rows of cells, block by block: one line is one row, and a quote encloses a whole cell.

The reader of Python's own takes a line end inside quotes, so that one stray quote turns hundreds of rows into a single cell. Here no cell
reaches over the end of its line.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import compress
from pathlib import Path
from typing import NamedTuple

from estimator.errors import InvalidInput, Place, reason
from estimator.given_files import MOST_TABLE_BYTES, open_given, text_of

BLOCK_BYTES = 4_000_000
QUOTED_CELL = r'"(?:[^"]|"")*+"'
NO_TEXT = "\0 \t"  # what a line holds that a log had reserved and never wrote


@cache
def _patterns(separator: str) -> tuple[re.Pattern[str], re.Pattern[str]]:
    """A whole row, and one of its cells."""
    bare = rf'[^"{re.escape(separator)}]*+'
    cell, between = f"(?:{QUOTED_CELL}|{bare})", re.escape(separator)
    return re.compile(f"{cell}(?:{between}{cell})*+"), re.compile(f"({QUOTED_CELL}|{bare})(?:{between}|$)")


class BadLine(NamedTuple):
    """A line that is no row like the others.

    Attributes:
        number: From 1.
        column: The cell that is wrong; None where the whole line is.
        rule: What a line must be.
        received: What this one is.
        cure: What to do about it beside leaving the line out.
    """

    number: int
    column: int | None
    rule: str
    received: str
    cure: str = ""


@dataclass(frozen=True)
class Block:
    """Some lines of a file; blank ones are left out.

    Attributes:
        path: The file.
        texts: The lines without their ends.
        numbers: Number of each line, from 1.
        is_plain: Whether no line holds a quote or a NUL.
        separator: Between cells; None for runs of blanks.
        may_comment: Whether a line may be a comment.
        n_optional: Cells at the end of a row that may be missing.
    """

    path: Path
    texts: list[str]
    numbers: Sequence[int]
    is_plain: bool
    separator: str | None = ","
    may_comment: bool = False
    n_optional: int = 0

    def rest(self, n: int) -> Block:
        """The block without its first lines."""
        return replace(self, texts=self.texts[n:], numbers=self.numbers[n:])

    def without(self, is_left_out: Callable[[str], bool]) -> Block:
        """The block without some of its lines."""
        pairs = [
            (text, number)
            for text, number in zip(self.texts, self.numbers, strict=True)
            if not is_left_out(text)
        ]
        return replace(self, texts=[text for text, _ in pairs], numbers=[number for _, number in pairs])

    def columns(self, width: int, bad_lines: list[BadLine]) -> tuple[Sequence[Sequence[str]], Sequence[int]]:
        """The cells by column, and the number of the line of each row.

        Args:
            width: Cells that a row must have.
            bad_lines: Takes the lines that are no rows; they are left out.
        """
        separator = self.separator
        if self.is_plain and separator and {text.count(separator) for text in self.texts} == {width - 1}:
            # One list is made far faster than one for each row.
            cells = separator.join(self.texts).split(separator)
            return [cells[column::width] for column in range(width)], self.numbers
        rows, numbers = [], []
        for text, number in zip(self.texts, self.numbers, strict=True):
            row = row_of(text, number, separator)
            if isinstance(row, BadLine):
                bad_lines.append(row)
                continue
            if len(row) > width and not any(cell.strip() for cell in row[width:]):
                row = row[:width]  # a separator at the end of the line
            elif width - self.n_optional <= len(row) < width:
                row = [*row, *[""] * (width - len(row))]
            if len(row) != width:
                rule = f"a row must have {width} cells like the header"
                bad_lines.append(BadLine(number, None, rule, f"{len(row)}"))
                continue
            rows.append(row)
            numbers.append(number)
        return list(zip(*rows, strict=True)) or [()] * width, numbers


def csv_blocks(path: Path, encoding: str = "utf-8", separator: str | None = ",") -> Iterator[Block]:
    """The lines of a CSV file, which end in LF, CR LF or CR; lines without text are left out.

    Args:
        path: The file.
        encoding: Of its text.
        separator: Between cells; None for runs of blanks.
    Raises:
        InvalidInput: The file cannot be read or is no text. The message names file and line.
    Examples:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp()) / "readings.csv"
        >>> _ = path.write_text("t_s,set" + chr(10) + '0,"calibration"')
        >>> [block.texts for block in csv_blocks(path)]
        [['t_s,set', '0,"calibration"']]
    """
    n_before = 0
    for text in _texts(path) if encoding == "utf-8" else _texts_in(path, encoding):
        lines = text.split("\n")
        if not lines[-1]:
            lines.pop()  # what follows the last line end is no line
        numbers: Sequence[int] = range(n_before + 1, n_before + 1 + len(lines))
        n_before += len(lines)
        if "\0" in text or not all(lines):
            are_there = [bool(line.strip().strip(NO_TEXT)) for line in lines]
            numbers = list(compress(numbers, are_there))
            lines = list(compress(lines, are_there))
        is_plain = '"' not in text and ("\0" not in text or not any("\0" in line for line in lines))
        yield Block(path, lines, numbers, is_plain, separator, "#" in text)


def cells_of(line: str, path: Path, number: int) -> list[str]:
    """The cells of one line.

    Args:
        line: Its text, without line end.
        path, number: Its place, for messages.
    Raises:
        InvalidInput: A quote does not enclose a whole cell, or the line holds a NUL.
    Examples:
        >>> cells_of('1,"day 2","a, b",', Path("readings.csv"), 2)
        ['1', 'day 2', 'a, b', '']
        >>> cells_of('1,"day 2,', Path("readings.csv"), 2)
        Traceback (most recent call last):
        ...
        estimator.errors.InvalidInput: a quote must enclose a whole cell; cell 2 has one too many or too few (readings.csv, line 2)
    """
    row = row_of(line, number, ",")
    if isinstance(row, BadLine):
        raise InvalidInput.at(Place(str(path), number, row.column), f"{row.rule}; {row.received}")
    return row


def row_of(line: str, number: int, separator: str | None) -> list[str] | BadLine:
    """The cells of one line, or what is wrong with it."""
    if "\0" in line:
        return BadLine(number, None, "a line must hold text", "it holds a NUL")
    if separator is None:
        return line.split()
    if '"' not in line:
        return line.split(separator)
    row, cell = _patterns(separator)
    if not row.fullmatch(line):
        right = row.match(line)
        column = len(cell.findall(line[: right.end()] + separator)) - 1 if right else 1
        rule, received = "a quote must enclose a whole cell", f"cell {column} has one too many or too few"
        return BadLine(number, column, rule, received, "remove or add the quote")
    return [
        text[1:-1].replace('""', '"') if text.startswith('"') else text
        for text in cell.findall(line + separator)[:-1]
    ]


def _texts_in(path: Path, encoding: str) -> Iterator[str]:
    """The text of a file in another encoding than UTF-8, in pieces of whole lines, with LF as line end."""
    with open_given(path, MOST_TABLE_BYTES, rule="must be readable as text") as file:
        text = io.TextIOWrapper(file, encoding, errors="replace", newline=None)
        while block := text.read(BLOCK_BYTES):
            yield (block + text.readline()).removeprefix("\ufeff")


def _texts(path: Path) -> Iterator[str]:
    """The text of a file in pieces of whole lines, with LF as line end."""
    rule = "must be readable as text"
    with open_given(path, MOST_TABLE_BYTES, rule=rule) as file:
        n_before = 0
        while True:
            try:
                block = file.read(BLOCK_BYTES) + file.readline()
            except OSError as error:
                raise InvalidInput(f"{path} {rule}: {reason(error)}") from error
            if not block:
                return
            text = text_of(block, path, first_line=1 + n_before)
            n_before += block.count(b"\n")
            yield text.replace("\r\n", "\n").replace("\r", "\n") if "\r" in text else text
