"""How a table stands in a text: between which lines, with which separator and decimal sign, and which lines name its columns."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from estimator.store.importers.csv_lines import BadLine, row_of
from estimator.store.importers.forms.cells import UNCLEAR, UNCLEAR_NUMBER, is_number, is_value
from estimator.store.importers.forms.declared import declared, grouped
from estimator.store.importers.forms.units import unit_named
from estimator.store.importers.table import is_absent

SEPARATORS: tuple[str | None, ...] = (",", ";", "\t", "|", None)
WORDS = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars", None: "blanks"}
COMMENTS = ("#", "%", "//")
FEWEST_NUMBERS = 2  # in a line of data
SAMPLE_LINES, SAMPLE_LETTERS = 400, 1_000_000
NO_CELLS = frozenset(
    ("", "comment", "comments", "remark", "remarks", "note", "notes")
)  # headings that rows may lack
NO_UNITS = frozenset(("", "-", "1", "a.u.", "none", "text", "string"))


class Line(NamedTuple):
    """A line of a text with its number, from 1."""

    number: int
    text: str


@dataclass(frozen=True)
class Layout:
    """How the rows of a text are read.

    Attributes:
        separator: Between cells; None for runs of blanks.
        decimal: Point or comma.
        header: Names of the columns; None where the text holds none.
        header_line: Their line, 0 where there is none.
        units: Units by column, from a line of their own; empty where there is none.
        first_line: Line of the first row.
        width: Cells of a row.
        n_optional: Cells at its end that may be missing: columns of comments.
        is_unclear: Whether a comma may be the decimal sign or part thousands.
    """

    separator: str | None
    decimal: str
    header: tuple[str, ...] | None
    header_line: int
    units: tuple[str, ...]
    first_line: int
    width: int
    n_optional: int = 0
    is_unclear: bool = False


def layout_of(
    lines: Sequence[Line], separators: Iterable[str | None] = SEPARATORS, decimals: Sequence[str] = ".,"
) -> Layout | None:
    """The layout in which most cells are numbers; None where no line holds two.

    Examples:
        >>> lines = [Line(1, "log"), Line(2, "t;B"), Line(3, "s;mT"), Line(4, "0,5;1,25"), Line(5, "1;2")]
        >>> layout = layout_of(lines)
        >>> layout.separator, layout.decimal, layout.header, layout.units, layout.first_line
        (';', ',', ('t', 'B'), ('s', 'mT'), 4)
    """
    data = [line for line in lines if not is_comment(line.text)]
    best, most = None, 0
    for separator in separators:
        rows = [(line, _cells(line, separator)) for line in data]
        for decimal in decimals:
            counts = [(line, row, sum(is_value(cell, decimal) for cell in row)) for line, row in rows]
            counts = [each for each in counts if each[2] >= max(FEWEST_NUMBERS, 0.4 * len(each[1]))]
            if not counts:
                continue
            width = Counter(len(row) for _, row, _ in counts).most_common(1)[0][0]
            total = sum(n for _, row, n in counts if len(row) == width)
            if width >= FEWEST_NUMBERS and total > most:
                first = next(line for line, row, _ in counts if len(row) == width)
                best, most = (
                    (separator, decimal, width, first, [(line, row) for line, row, _ in counts]),
                    total,
                )
    if best is None:
        return None
    separator, decimal, width, first, data_rows = best
    most_cells = max(len(_split(line, separator)) for line, row in data_rows if len(row) == width)
    header, header_line, units = _header(lines, first.number, separator, (width, most_cells))
    # A torn line below the header is a row with a fault, a line of dashes is none.
    starts = [
        line.number
        for line in data
        if header_line < line.number < first.number
        and sum(is_number(cell, decimal) for cell in _cells(line, separator)) >= FEWEST_NUMBERS
    ]
    first_line = min([*starts, first.number]) if header is not None else first.number
    unclear = decimals == ".," and _is_unclear(row for _, row in data_rows)
    n_optional = 0 if header is None else len(header) - width
    return Layout(
        separator, decimal, header, header_line, units, first_line, width + n_optional, n_optional, unclear
    )


def is_comment(text: str) -> bool:
    """Whether a line is a comment."""
    return text.lstrip().startswith(COMMENTS)


def _split(line: Line, separator: str | None) -> list[str]:
    row = row_of(line.text, line.number, separator)
    return line.text.split(separator) if isinstance(row, BadLine) else row


def _cells(line: Line, separator: str | None) -> list[str]:
    row = _split(line, separator)
    while len(row) > FEWEST_NUMBERS and not row[-1].strip():  # a separator at the end of the line
        row = row[:-1]
    return [cell.strip() for cell in row]


def _is_unclear(rows: Iterable[Sequence[str]]) -> bool:
    """Whether commas in numbers may stand for the decimal sign or part thousands, and no cell tells which."""
    cells = [cell.strip() for row in rows for cell in row]
    with_comma = [cell for cell in cells if "," in cell and (is_number(cell, ".") or is_number(cell, ","))]
    if not with_comma or not all(UNCLEAR.match(cell) for cell in with_comma):
        return False
    has_point = any("." in cell and is_number(cell, ".") for cell in cells)
    return not has_point and all(UNCLEAR_NUMBER.match(cell) for cell in with_comma)


def _header(
    lines: Sequence[Line], first: int, separator: str | None, widths: tuple[int, int]
) -> tuple[tuple[str, ...] | None, int, tuple[str, ...]]:
    """Names of the columns, their line, and their units, from the lines above the first row of numbers."""
    above, width = [line for line in lines if line.number < first], widths[0]
    units: tuple[str, ...] = ()
    for number, line in reversed(list(enumerate(above))):
        names = header_names(line.text, separator, *widths)
        if names is None:
            continue
        if not units and _are_units(names):
            units = names[:width]
            continue
        if number and separator is not None and _has_doubles(names):
            groups = next(iter(_splits(above[number - 1].text, separator)))
            if len(groups) <= len(names) and any(groups):
                names = grouped([*groups, *[""] * (len(names) - len(groups))], names)
        return names, line.number, units
    if names := declared([line.text for line in above], width):
        return names, above[-1].number, ()
    return None, 0, ()


def _has_doubles(names: Sequence[str]) -> bool:
    given = [name for name in names if name]
    return len(set(given)) < len(given)


def header_names(text: str, separator: str | None, width: int, most_cells: int = 0) -> tuple[str, ...] | None:
    """Cells of a line that may name as many columns as rows have, and columns of comments; None where it does not.

    Args:
        text: The line.
        separator: Between cells.
        width: Cells of a row, without empty ones at its end.
        most_cells: Cells of a row with those: a column that is nearly always empty is one of comments, whatever its name.
    Examples:
        >>> header_names("# t_s, Bx_mT", ",", 2), header_names("x [mm]  B x [G]", None, 2), header_names("a b c", None, 2)
        (('t_s', 'Bx_mT'), ('x [mm]', 'B x [G]'), None)
    """
    text = re.sub(r"^\s*(?:#+|%+|//+)\s*", "", text).strip("\ufeff")
    for cells in _splits(text, separator):
        names = tuple(cell.strip().strip("\"'") for cell in cells)
        while len(names) > width and not names[-1]:
            names = names[:-1]
        n_comments = sum(name.lower() in NO_CELLS for name in names[width:])
        n_words = sum(any(letter.isalpha() for letter in name) for name in names)
        is_text = n_words >= FEWEST_NUMBERS and not any(is_number(name, ".") for name in names)
        if (len(names) - n_comments == width or width < len(names) <= most_cells) and is_text:
            return names
    return None


def _splits(text: str, separator: str | None) -> Iterable[list[str]]:
    if separator is not None:
        row = row_of(text, 1, separator)
        yield text.split(separator) if isinstance(row, BadLine) else row
        if separator not in text:
            yield re.split(r"\s*[,;\t]\s*", text)
        return
    yield text.split()
    yield re.split(r"\t+|\s{2,}", text.strip())
    # A unit in brackets belongs to the name before it, and a letter of a component to the field.
    yield re.findall(r"[^\s\[(]+(?:\s*[\[(][^\])]*[\])])?", text)
    yield re.split(r"\s*[,;]\s*", text)


def _are_units(names: Sequence[str]) -> bool:
    """Whether cells are units, in brackets or not."""
    symbols = [strip_brackets(name) for name in names]
    n_units = sum(unit_named(name) is not None for name in symbols)
    n_words = sum(name.lower() not in NO_UNITS and not is_absent(name) for name in symbols)
    return n_units >= FEWEST_NUMBERS and n_units >= 0.6 * n_words


def strip_brackets(name: str) -> str:
    """A unit without the brackets around it."""
    return re.sub(r"^[\[(](.*)[\])]$", r"\1", name.strip()).strip()
