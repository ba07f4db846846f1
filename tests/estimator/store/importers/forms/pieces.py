"""Columns, headings and rows of which forms are made."""

from __future__ import annotations

import datetime

import numpy as np

from tests.estimator.store.importers.forms.written import (
    HEADER,
    TABLE,
    text,
)

T, CURRENT, X, Y, Z, BX, BY, BZ = TABLE.T
PLAIN = text()
LINES = PLAIN.splitlines()
MICRO = [*HEADER[:5], "Bx [µT]", "By [µT]", "Bz [µT]"]
LAB = ["Time [s]", "I coil (A)", "X [mm]", "Y [mm]", "Z [mm]", "Hall Bx/G", "Hall By/G", "Hall Bz/G"]
IN_G = [1.0, 1.0, 1.0, 1.0, 1.0, 100.0, 100.0, 100.0]
BARE = ["time", "current", "x", "y", "z", "bx", "by", "bz"]
UNITS = {
    "t": "s",
    "coil1_current": "A",
    "stage_x": "mm",
    "stage_y": "mm",
    "stage_z": "mm",
    "Bx": "uT",
    "By": "uT",
    "Bz": "uT",
}
NAN = float("nan")


def lines(*parts: str) -> bytes:
    return ("\n".join(parts) + "\n").encode()


def without_first_cell(line: str, cells: int) -> str:
    return ",".join(["", *line.split(",")[cells:]])


def with_nan(*places: tuple[int, int]) -> np.ndarray:
    rows = TABLE.copy()
    for place in places:
        rows[place] = NAN
    return rows


def clock(second: float, start: datetime.datetime, pattern: str) -> str:
    return (start + datetime.timedelta(seconds=second)).strftime(pattern)


NOON = datetime.datetime(2026, 3, 1, 12, 0, 0)
BACK = np.concatenate((T[:40], T[:20]))
ODD = np.concatenate((T[:40], T[:20] - 0.25))
AFTER = np.concatenate((T[:40], 20.0 + T[:20]))
