"""Lines of a CSV file as rows of cells, block by block: one line is one row, and a quote encloses a whole cell.

The reader of Python's own takes a line end inside quotes, so that one stray quote turns hundreds of rows into a single cell. Here no cell
reaches over the end of its line.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from estimator.errors import Faults, InvalidInput, Place, reason
from estimator.given_files import MOST_TABLE_BYTES, open_given, text_of

BLOCK_BYTES = 4_000_000
QUOTED_CELL = r'"(?:[^"]|"")*+"'
ROW = re.compile(rf'(?:{QUOTED_CELL}|[^",]*+)(?:,(?:{QUOTED_CELL}|[^",]*+))*+')
CELL = re.compile(rf'({QUOTED_CELL}|[^",]*+)(?:,|$)')


@dataclass(frozen=True)
class Block:
    """Some lines of a file; blank ones are left out.

    Attributes:
        path: The file.
        texts: The lines without their ends.
        numbers: Number of each line, from 1.
        is_plain: Whether no line holds a quote or a NUL.
    """

    path: Path
    texts: list[str]
    numbers: Sequence[int]
    is_plain: bool

    def rest(self, n: int) -> Block:
        """The block without its first lines."""
        return Block(self.path, self.texts[n:], self.numbers[n:], self.is_plain)

    def columns(self, width: int, faults: Faults) -> tuple[Sequence[Sequence[str]], Sequence[int]]:
        """The cells by column, and the number of the line of each row.

        Args:
            width: Cells that a row must have.
            faults: Where a fault is noted or raised; its line is left out.
        """
        if self.is_plain and {text.count(",") for text in self.texts} == {width - 1}:
            cells = ",".join(self.texts).split(",")  # one list is made far faster than one for each row
            return [cells[column::width] for column in range(width)], self.numbers
        rows, numbers = [], []
        for text, number in zip(self.texts, self.numbers, strict=True):
            with faults.noting():
                row = cells_of(text, self.path, number)
                if len(row) != width:
                    rule = f"a row must have {width} cells like the header"
                    words = f"{rule}; received {len(row)} ({self.path}, line {number})"
                    raise InvalidInput(words, Place(str(self.path), number))
                rows.append(row)
                numbers.append(number)
        return list(zip(*rows, strict=True)) or [()] * width, numbers


def csv_blocks(path: Path) -> Iterator[Block]:
    """The lines of a CSV file in UTF-8, which end in LF, CR LF or CR.

    Args:
        path: The file.
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
    for text in _texts(path):
        lines = text.split("\n")
        if not lines[-1]:
            lines.pop()  # what follows the last line end is no line
        numbers: Sequence[int] = range(n_before + 1, n_before + 1 + len(lines))
        n_before += len(lines)
        if not all(lines):
            numbers = [number for number, line in zip(numbers, lines, strict=True) if line.strip()]
            lines = [line for line in lines if line.strip()]
        yield Block(path, lines, numbers, '"' not in text and "\0" not in text)


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
    if "\0" in line:
        raise InvalidInput(
            f"a line must hold text; it holds a NUL ({path}, line {number})", Place(str(path), number)
        )
    if '"' not in line:
        return line.split(",")
    if not ROW.fullmatch(line):
        right = ROW.match(line)
        column = len(CELL.findall(line[: right.end()] + ",")) - 1 if right else 1
        words = f"a quote must enclose a whole cell; cell {column} has one too many or too few"
        raise InvalidInput(f"{words} ({path}, line {number})", Place(str(path), number, column))
    return [
        cell[1:-1].replace('""', '"') if cell.startswith('"') else cell
        for cell in CELL.findall(line + ",")[:-1]
    ]


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
