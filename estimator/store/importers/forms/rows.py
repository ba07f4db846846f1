"""Rows of a file of readings with their layout, whether it is text or not."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

from estimator.errors import InvalidInput, Place
from estimator.store.importers.csv_lines import BadLine, Block, csv_blocks, row_of
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
from estimator.store.importers.forms.no_table import rule_broken
from estimator.store.importers.forms.recipe import DECIMALS, SEPARATOR_OF, Recipe
from estimator.store.importers.forms.sources import CELL_SEPARATOR, grid_of, renumbered

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
