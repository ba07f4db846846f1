"""What to do with a text whose rows are not cells of one number each: the sentence of a refusal."""

from __future__ import annotations

import re
from collections.abc import Sequence

from estimator.errors import quoted
from estimator.store.importers.forms.cells import is_number
from estimator.store.importers.forms.layout import Line
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
