"""Times of day and dates of a table become seconds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from estimator.errors import InvalidInput, quoted
from estimator.store.importers.common import moment
from estimator.store.importers.forms.cells import (
    DATE_CELL,
    DAY_S,
    HALF_DAY_S,
    Stamp,
    day_of,
    is_day_first,
    moment_of,
    stamp_of,
)
from estimator.store.importers.forms.recipe import CLOCK, DATE
from estimator.store.importers.table import Cells, HeaderCell, Table


def with_times(table: Table) -> tuple[str, Table]:
    """When the first reading was taken, empty where no date says it; and the table with seconds instead of times of day.

    Raises:
        InvalidInput: A cell is no time, or dates may be of two kinds.
    """
    if CLOCK not in table:
        return "", table
    clock, header = table.columns[CLOCK], table.header[CLOCK]
    dates = table.columns[DATE].words if DATE in table else []
    has_day_first = is_day_first([*clock.words, *dates])
    stamps = [stamp_of(word, bool(has_day_first)) for word in clock.words]
    rule = (
        f"{header.text} must be a time of day, such as 12:00:00.5, with a date such as 2026-03-01 or without"
    )
    is_bad = np.array([stamp is None for stamp in stamps])[clock.codes]
    table.refuse_rows(CLOCK, is_bad, rule, lambda row: quoted(clock.words[clock.codes[row]]))
    second = np.array([0.0 if stamp is None else stamp.second for stamp in stamps])[clock.codes]
    day = _days(table, stamps, bool(has_day_first))
    if day is None:
        # A clock without a date begins anew at midnight.
        midnights = np.concatenate(([0.0], np.cumsum(np.diff(second) < -HALF_DAY_S)))
        time_s, created = second + DAY_S * midnights, ""
    else:
        if has_day_first is None and len(np.unique(day[~is_bad])) > 1:
            words = "dates must say which number is the day; all of them may be read both ways: write them as 2026-03-01"
            raise InvalidInput(f"{words} ({table.path}, column {header.text})")
        time_s = second + DAY_S * (day - day.min())
        created = "" if has_day_first is None else _created(second, day)
    columns = {key: cells for key, cells in table.columns.items() if key not in {CLOCK, DATE}}
    headers = {key: cell for key, cell in table.header.items() if key not in {CLOCK, DATE}}
    columns["t"] = Cells.of_numbers(time_s)
    headers["t"] = HeaderCell(header.column, header.text, 1.0)
    return created, replace(table, columns=columns, header=headers)


def _days(table: Table, stamps: list[Stamp | None], has_day_first: bool) -> npt.NDArray[np.float64] | None:
    """Number of the day of each row; None where no date is there."""
    if DATE in table:
        cells = table.columns[DATE]
        days = [_ordinal(word, has_day_first) for word in cells.words]
        is_bad = np.array([day is None for day in days])[cells.codes]
        rule = f"{table.header[DATE].text} must be a date such as 2026-03-01"
        table.refuse_rows(DATE, is_bad, rule, lambda row: quoted(cells.words[cells.codes[row]]))
        return np.array([day or 0 for day in days], dtype=np.float64)[cells.codes]
    known = [stamp.day for stamp in stamps if stamp is not None and stamp.day is not None]
    if len(known) < len(stamps):
        return None
    ordinals = [0 if stamp is None or stamp.day is None else stamp.day.toordinal() for stamp in stamps]
    return np.array(ordinals, dtype=np.float64)[table.columns[CLOCK].codes]


def _ordinal(word: str, has_day_first: bool) -> int | None:
    try:
        day = day_of(word, has_day_first) if DATE_CELL.match(word) or ":" in word or "T" in word else None
    except ValueError:
        return None
    return None if day is None else day.toordinal()


def _created(second: npt.NDArray[np.float64], day: npt.NDArray[np.float64]) -> str:
    """The moment of the first reading; empty where that lies in the future, as on a clock that was never set."""
    from datetime import date

    first = int(np.lexsort((second, day))[0])
    try:
        return moment(
            moment_of(Stamp(float(second[first]), date.fromordinal(int(day[first])))), "recorded_at"
        )
    except (InvalidInput, ValueError):
        return ""
