"""Rows of a file of readings with their layout, whether it is text or not, and what to do with a text that has no such rows."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

from estimator.errors import InvalidInput, Place, quoted
from estimator.store.importers.csv_lines import BadLine, Block, csv_blocks, row_of
from estimator.store.importers.forms.cells import is_number
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
from estimator.store.importers.forms.recipe import DECIMALS, SEPARATOR_OF, Recipe
from estimator.store.importers.forms.sources import CELL_SEPARATOR, grid_of, renumbered
from estimator.store.importers.forms.units import unit_named

WITH_UNIT = re.compile(
    r"(?:^|[,;\t|])\s*(?P<cell>[+-]?[\d.]+(?:[eE][+-]?\d+)?\s*(?P<unit>[^\s\d,;|.+-]+))\s*(?=$|[,;\t|])"
)
TOGETHER = re.compile(
    r"[(\[{]\s*[+-]?[\d.]+(?:[eE][+-]?\d+)?(?:\s*[,;\s]\s*[+-]?[\d.]+(?:[eE][+-]?\d+)?)+\s*[)\]}]"
)
MOSTLY = 0.6
LONG = 20  # cells of a row that are readings rather than columns


def rule_broken(lines: Sequence[Line]) -> str | None:
    """The rule that the lines break, and the cure; None where they are numbers in columns.

    Examples:
        >>> rule_broken([Line(1, "t,I"), Line(2, "0 s,3 A")])
        "a cell must hold a number alone; received '0 s' in line 2: write units into the header, such as t [s], and only numbers below"
        >>> rule_broken([Line(1, "t;B"), Line(2, "0;(1, 2, 3)")])
        "a cell must hold one number; received '(1, 2, 3)' in line 2: write each component into a column of its own"
    """
    for line in lines:
        if match := TOGETHER.search(line.text):
            cure = "write each component into a column of its own"
            return f"a cell must hold one number; received {quoted(match[0])} in line {line.number}: {cure}"
        if (match := WITH_UNIT.search(line.text)) and unit_named(match["unit"]) is not None:
            cure = "write units into the header, such as t [s], and only numbers below"
            return f"a cell must hold a number alone; received {quoted(match['cell'])} in line {line.number}: {cure}"
    return _exchanged(lines)


def _exchanged(lines: Sequence[Line]) -> str | None:
    """The sentence for a table whose columns stand as lines."""
    rows = [re.split(r"[,;\t|]|\s+", line.text.strip()) for line in lines]
    begin_with_names = [
        row for row in rows if row[0][:1].isalpha() and len(row) > LONG and _are_numbers(row[-LONG:])
    ]
    if len(begin_with_names) < max(2.0, MOSTLY * len(rows)):
        return None
    cure = "exchange rows and columns (in a spreadsheet: copy, paste special, transpose)"
    return f"a row must be a reading; here each line begins with the name of a quantity: {cure}"


def _are_numbers(cells: Sequence[str]) -> bool:
    return all(is_number(cell, ".") for cell in cells)


LONGEST_LINE = 100_000  # characters: more columns than a file may have


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
            yield replace(rows, n_optional=self.layout.n_optional)

    def sample_rows(self) -> list[list[str]]:
        """Cells of some rows."""
        rows = []
        for line in self.lines:
            if line.number >= self.layout.first_line and not is_comment(line.text):
                row = row_of(line.text, line.number, self.layout.separator)
                if not isinstance(row, BadLine) and len(row) >= self.layout.width - self.layout.n_optional:
                    rows.append(row)
        return rows


def text_source(path: Path, recipe: Recipe) -> Source:
    """The rows of a text."""
    encoding = recipe.encoding or encoding_of(path)
    try:
        blocks = csv_blocks(path, encoding, None)
        first = next(blocks, Block(path, [], [], True))
    except LookupError:
        raise InvalidInput(
            f"encoding must be one that Python knows; received {encoding!r} ({path})"
        ) from None
    lines = first_lines(first.texts, first.numbers)
    for line in lines:
        if len(line.text) > LONGEST_LINE:
            words = f"a line must have at most {LONGEST_LINE} characters; received {len(line.text)}"
            raise InvalidInput.at(Place(str(path), line.number), f"{words}; write one reading a line")
    separators = SEPARATORS if recipe.separator is None else (SEPARATOR_OF[recipe.separator],)
    decimals = ".," if recipe.decimal is None else DECIMALS[recipe.decimal]
    layout = layout_of(lines, separators, decimals)
    if (layout is None or layout.header is None) and (rule := rule_broken(lines)) is not None:
        raise InvalidInput(f"{rule} ({path})")
    if layout is None:
        words = f"{path} must hold a header and rows of numbers"
        raise InvalidInput(
            f"{words}; no line holds two numbers between commas, semicolons, tabs or blanks: export it as CSV"
        )
    if layout.is_unclear:
        words = "commas must be decimal signs or part thousands; both fit all numbers"
        cure = "say it with --decimal comma or --decimal point"
        raise InvalidInput.at(Place(str(path), layout.first_line), f"{words}: {cure}")
    decimal = "decimal commas" if layout.decimal == "," else "decimal points"
    told = f"Text in {encoding.replace('_', '-')}, separated by {WORDS[layout.separator]}, with {decimal}"
    return Source(path, layout, encoding, "", tuple(lines), None, (told + _above(layout, lines),))


def grid_source(path: Path, kind: str, recipe: Recipe) -> Source:
    """The rows of a file that is no text."""

    def layout_in(block: Block) -> Layout | None:
        return layout_of(first_lines(block.texts, block.numbers), (CELL_SEPARATOR,))

    grid = grid_of(path, kind, recipe.sheet, lambda block: layout_in(block) is not None)
    layout = layout_in(grid.block)
    if layout is None:
        raise InvalidInput(f"{path} must hold a header and rows of numbers; it holds none")
    lines = first_lines(grid.block.texts, grid.block.numbers)
    told = f"Sheet {grid.name!r}" if kind == "workbook" else f"Arrays of one length in a file of kind {kind}"
    if grid.others:
        told += f" ({len(grid.others)} more are left out)"
    sheet = grid.name if kind == "workbook" else ""
    return Source(path, layout, "", sheet, tuple(lines), grid.block, (told + _above(layout, lines),))


def first_lines(texts: Sequence[str], numbers: Sequence[int]) -> list[Line]:
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
