"""Places of one fault in a file, as a sentence lists them: the first three, and how many more there are."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from estimator.errors import InvalidInput, Place, listed

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
