"""Names of columns in more than one line above the rows: a line for each column, or a group above its components."""

from __future__ import annotations

import re
from collections.abc import Sequence

BRACKETED = re.compile(r"^(?P<what>.*?)\s*(?P<unit>[\[(][^\])]*[\])])$")
# `4 BX [TESLA]` of Opera, `# 4: Bx [T]`, `# column 4 = Bx (T)`
NUMBERED = re.compile(
    r"^\W*(?:col(?:umn)?\b)?\W*(?P<number>\d+)\s*[-:=.)]*\s+(?P<name>[^\W\d].*?)\s*$", re.IGNORECASE
)
SDDS = re.compile(
    r"^\s*&column\b.*?\bname\s*=\s*(?P<name>[^\s,]+)(?:.*?\bunits\s*=\s*(?P<unit>[^\s,]+))?", re.IGNORECASE
)
IGOR = re.compile(r"^\s*WAVES(?:/\w+)*\s+(?P<names>.+)$")


def declared(texts: Sequence[str], width: int) -> tuple[str, ...] | None:
    """Names that lines above the rows give the columns, one after another; None where they do not.

    Examples:
        >>> declared(["7 1 1 2", "1 X [MM]", "2 BX [TESLA]", "0"], 2), declared(["# 0: t (s)", "# 1: I (A)"], 2)
        (('X [MM]', 'BX [TESLA]'), ('t (s)', 'I (A)'))
        >>> declared(["&column name=t, units=s, &end", "&column name=I, &end"], 2), declared(["WAVES/D t_s, I_A", "BEGIN"], 3)
        (('t [s]', 'I'), ('', 't_s', 'I_A'))
    """
    numbered = [match for match in map(NUMBERED.match, texts) if match][-width:]
    numbers = [int(match["number"]) for match in numbered]
    if len(numbers) == width and numbers in (list(range(width)), list(range(1, width + 1))):
        return tuple(match["name"] for match in numbered)
    described = [match for match in map(SDDS.match, texts) if match]
    if len(described) == width:
        return tuple(
            f"{match['name']} [{match['unit']}]" if match["unit"] else match["name"] for match in described
        )
    for match in filter(None, map(IGOR.match, texts)):
        names = tuple(name.strip() for name in match["names"].split(","))
        if width - len(names) in (0, 1):  # rows begin with a tab
            return ("",) * (width - len(names)) + names
    return None


def grouped(groups: Sequence[str], names: Sequence[str]) -> tuple[str, ...]:
    """Names of columns, each with the group that stands above it or above a column to its left.

    Examples:
        >>> grouped(["t [s]", "Position [mm]", "", "Field (uT)"], ["", "x", "y", "x"])
        ('t [s]', 'Position x [mm]', 'Position y [mm]', 'Field x (uT)')
    """
    whole, group = [], ""
    for above, name in zip(groups, names, strict=True):
        group = above.strip() or group
        match = BRACKETED.match(group)
        if not name or match is None or BRACKETED.match(name):
            whole.append(f"{group} {name}".strip())
        else:
            whole.append(f"{match['what']} {name} {match['unit']}")
    return tuple(whole)
