"""Cells as people and instruments write them: decimal commas, thousands, times of day. They become numbers as Python writes them."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from datetime import date, datetime
from typing import NamedTuple

from estimator.store.importers.table import is_absent

BLANKS = "\u00a0\u202f\u2009"  # of no width or fixed width, as thousands have them
SIGNS = str.maketrans({"\u2212": "-", "\u2013": "-"} | dict.fromkeys(BLANKS, " "))
EXPONENT = r"(?:[eEdD][+-]?\d+)?"
# No zero leads thousands: 0,448 has a decimal comma.
GROUPS = r"[+-]?[1-9]\d{0,2}(?:[%s]\d{3})+"
POINT = re.compile(rf"[+-]?(?:\d+\.?\d*|\.\d+){EXPONENT}$")
POINT_GROUPED = re.compile(GROUPS % ",' " + rf"(?:\.\d*)?{EXPONENT}$")
COMMA = re.compile(rf"[+-]?(?:\d+(?:,\d+)?|,\d+){EXPONENT}$")
COMMA_GROUPED = re.compile(GROUPS % ".' " + rf"(?:,\d*)?{EXPONENT}$")
UNCERTAINTY = re.compile(
    r"(?<=\d)\s*(?:(?:±|\+/?-)\s*[\d.,]+(?:[eE][+-]?\d+)?|\(\d+\))$"
)  # 1.5±0.1, 1.5 +/- 0.1, 1.52(3)
# 1,000 may be a thousand or one; 0,500 and 12,5 may not.
UNCLEAR = re.compile(r"[+-]?[1-9]\d{0,2}(?:,\d{3})+$")
UNCLEAR_NUMBER = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}$")
DAY = (
    r"(?:(?P<y>\d{4})[-/.](?P<m>\d\d?)[-/.](?P<d>\d\d?)|(?P<a>\d\d?)[-/.](?P<b>\d\d?)[-/.](?P<c>\d{4}|\d\d))"
)
TIME = r"(?P<H>\d\d?):(?P<M>\d\d)(?::(?P<S>\d\d)(?:[.,:](?P<f>\d+))?)?\s*(?P<pm>[AaPp][Mm])?(?:Z|[+-]\d\d:?\d\d)?"
DATE_CELL = re.compile(rf"{DAY}$")
CLOCK_CELL = re.compile(rf"(?:{DAY}[T ,]\s*)?{TIME}$")
MINUTES_CELL = re.compile(r"(?P<M>\d+):(?P<S>\d\d)[.,](?P<f>\d+)$")  # as spreadsheets show short times
HALF_DAY_S, DAY_S = 43200.0, 86400.0


def is_number(cell: str, decimal: str) -> bool:
    """Whether a cell is a number, with an uncertainty or without.

    Examples:
        >>> is_number("1,000.4", "."), is_number("1.000,4", ","), is_number("11,6", "."), is_number("1.5D-03", ".")
        (True, True, False, True)
        >>> is_number("-3.5 +/- 0.1", "."), is_number("12,52(3)", ","), is_number("(3)", ".")
        (True, True, False)
    """
    text = _value(cell)
    patterns = (POINT, POINT_GROUPED) if decimal == "." else (COMMA, COMMA_GROUPED)
    return any(pattern.match(text) for pattern in patterns)


def is_value(cell: str, decimal: str) -> bool:
    """Whether a cell is a number, a time, a date, or says that there is none."""
    text = cell.strip()
    is_time = ":" in text and is_clock(text)
    return is_number(text, decimal) or is_time or DATE_CELL.match(text) is not None or is_absent(text)


def is_clock(cell: str) -> bool:
    """Whether a cell is a time of day, with a date or without, or minutes and seconds."""
    text = cell.strip()
    return CLOCK_CELL.match(text) is not None or MINUTES_CELL.match(text) is not None


def plain_numbers(decimal: str) -> Callable[[Sequence[str]], Sequence[str]]:
    """What turns cells into numbers as Python writes them; cells that are none stay as they are.

    Examples:
        >>> plain_numbers(",")(["-403,8", "1.000,25", "1.5", "OVLD"])
        ['-403.8', '1000.25', '1.5?', 'OVLD']
        >>> plain_numbers(".")(["1,000.4", "2.5D-3", "7"])
        ['1000.4', '2.5e-3', '7']
    """

    def plain(cells: Sequence[str]) -> Sequence[str]:
        return _quickly(cells, decimal) or [_plain(cell, decimal) for cell in cells]

    return plain


def _quickly(cells: Sequence[str], decimal: str) -> Sequence[str] | None:
    """The cells all at once, where each is a number without thousands; else None."""
    if decimal == ",":
        together = "\n".join(cells)
        if "." in together:
            return None
        cells = together.replace(",", ".").split("\n")
    try:
        for cell in cells:
            float(cell)
    except ValueError:
        return None
    return cells


def _value(cell: str) -> str:
    """A cell without the uncertainty behind its number."""
    return UNCERTAINTY.sub("", cell.strip()).translate(SIGNS)


def _plain(cell: str, decimal: str) -> str:
    text = _value(cell)
    if decimal == ".":
        if POINT_GROUPED.match(text):
            text = re.sub("[,' ]", "", text)
        return re.sub("[dD]", "e", text) if POINT.match(text) else text
    if COMMA_GROUPED.match(text):
        text = re.sub("[.' ]", "", text)
    if COMMA.match(text):
        return re.sub("[dD]", "e", text.replace(",", "."))
    return f"{text}?" if POINT.match(text) else text


class Stamp(NamedTuple):
    """A time of day, and the day where it is there."""

    second: float
    day: date | None


def is_day_first(cells: Sequence[str]) -> bool | None:
    """Whether dates such as 3/4/2026 begin with the day; None where they do not tell, nor differ."""
    dates = [match for match in map(re.compile(DAY).match, cells) if match and match["a"]]
    if not dates or any("." in match[0] for match in dates) or any(int(match["a"]) > 12 for match in dates):
        return True
    if any(int(match["b"]) > 12 for match in dates):
        return False
    return None


def stamp_of(cell: str, has_day_first: bool) -> Stamp | None:
    """The time that a cell holds; None where it holds none.

    Examples:
        >>> stamp_of("12:00:01,5", True), stamp_of("2026-03-01T01:30 PM", True)
        (Stamp(second=43201.5, day=None), Stamp(second=48600.0, day=datetime.date(2026, 3, 1)))
    """
    match = CLOCK_CELL.match(cell.strip())
    if match is None:
        short = MINUTES_CELL.match(cell.strip())
        return short and Stamp(60.0 * int(short["M"]) + float(f"{short['S']}.{short['f']}"), None)
    hour, half = int(match["H"]), (match["pm"] or "").lower()
    if half:
        hour = hour % 12 + (12 if half == "pm" else 0)
    minute, second = int(match["M"]), float(f"{match['S'] or 0}.{match['f'] or 0}")
    if hour > 23 or minute > 59 or second >= 61.0:
        return None
    try:
        day = day_of(match[0], has_day_first)
    except ValueError:
        return None
    return Stamp(3600.0 * hour + 60.0 * minute + second, day)


def day_of(text: str, has_day_first: bool) -> date | None:
    """The date at the begin of a text; None where there is none.

    Raises:
        ValueError: There is no such day.
    """
    match = re.match(DAY, text.strip())
    if match is None:
        return None
    if match["y"]:
        return date(int(match["y"]), int(match["m"]), int(match["d"]))
    day, month = (match["a"], match["b"]) if has_day_first else (match["b"], match["a"])
    year = int(match["c"]) + (2000 if len(match["c"]) == 2 else 0)
    return date(year, int(month), int(day))


def moment_of(stamp: Stamp) -> str:
    """A time of a known day as ISO 8601, in local time.

    Examples:
        >>> moment_of(Stamp(3723.5, date(2026, 3, 1)))
        '2026-03-01T01:02:03'
    """
    assert stamp.day is not None
    second = int(stamp.second)
    time = datetime(
        stamp.day.year, stamp.day.month, stamp.day.day, second // 3600, second // 60 % 60, second % 60
    )
    return time.isoformat()
