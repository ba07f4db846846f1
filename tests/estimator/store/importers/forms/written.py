"""One table of 60 readings in the forms that spreadsheets, instruments and scripts give it; all numbers are made up here."""

from __future__ import annotations

import csv
import datetime
import gzip
import io
import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

RIG = """
schema_version: 1
name: bench
movers: {stage: {motion: displacement}}
coils:
  coil1:
    radius_mm: {prior: {normal: {mean: 52, sd: 1}}}
    wire_radius_mm: 0.5
    axial_loops: 12
    radial_loops: 10
    world_from_coil: {z_mm: {prior: {normal: {mean: -40, sd: 2}}}}
sensors: {hall: {carried_by: stage, noise_uT: 10}}
"""
TWO_SENSORS = RIG.replace(
    "{hall: {carried_by: stage, noise_uT: 10}}",
    "{probe1: {carried_by: stage, noise_uT: 10}, "
    "probe2: {carried_by: stage, noise_uT: 10, world_from_sensor0: {x_mm: 5}}}",
)
TWO_COILS = RIG.replace(
    "sensors:",
    """  coil2:
    radius_mm: 52
    wire_radius_mm: 0.5
    axial_loops: 12
    radial_loops: 10
    world_from_coil: {z_mm: 60}
sensors:""",
)
EARTH_uT = np.array([18.0, -4.0, -43.0])
HEAD = "t_s,coil1_current_A,stage_x_mm,stage_y_mm,stage_z_mm,Bx_uT,By_uT,Bz_uT"
HEADER = tuple(HEAD.split(","))
REST, PLACES = HEAD.removeprefix("t_s,"), HEAD.partition(",Bx")[0]  # without the time, without the field
LAB = "Time [s],I coil (A),X [mm],Y [mm],Z [mm],Hall Bx/G,Hall By/G,Hall Bz/G"


def field_uT(place_mm: np.ndarray, current_A: np.ndarray) -> np.ndarray:
    """Biot-Savart for one loop of 120 turns, in 90 straight pieces."""
    angle = np.linspace(0.0, 2.0 * np.pi, 91)
    corner_m = np.stack((0.052 * np.cos(angle), 0.052 * np.sin(angle), np.full(91, -0.04)), 1)
    middle_m, step_m = (corner_m[1:] + corner_m[:-1]) / 2, np.diff(corner_m, axis=0)
    away_m = 1e-3 * place_mm[:, None] - middle_m
    unit = (np.cross(step_m, away_m) / np.linalg.norm(away_m, axis=-1, keepdims=True) ** 3).sum(axis=1)
    return 1e6 * 1e-7 * 120 * current_A[:, None] * unit


def table() -> np.ndarray:
    """Rows of time, current, place and field, as a file has them."""
    rng = np.random.default_rng(5)
    place_mm = np.round(np.repeat(rng.uniform(-30.0, 30.0, size=(15, 3)), 4, axis=0), 1)
    current_A = np.tile([-3.0, 3.0, 1.5, 0.0], 15)
    measured_uT = np.round(field_uT(place_mm, current_A) + EARTH_uT + rng.normal(size=(60, 3)), 1)
    return np.column_stack((0.5 * np.arange(60), current_A, place_mm, measured_uT))


TABLE = table()
T, CURRENT, X, Y, Z, BX, BY, BZ = TABLE.T
MILLI = TABLE / [1, 1, 1, 1, 1, 1e3, 1e3, 1e3]
IN_G = TABLE / [1, 1, 1, 1, 1, 100, 100, 100]
IN_T = TABLE / [1, 1, 1, 1, 1, 1e6, 1e6, 1e6]
UNITS = dict(name.rsplit("_", 1) for name in HEADER)


@dataclass(frozen=True)
class Form:
    """A file, and what must come of it.

    Attributes:
        name: Of the file.
        content: Its bytes, or its text.
        is_read: Whether it is read at once; otherwise it is refused, and the cure must work.
        expected: Rows as `TABLE`.
        units: The true unit of a quantity, where a refusal asks for it.
        rig: Its rig.
        answer: What the user does besides, where a refusal asks for something that only the user can do: the file in another form.
        tells: Words of the refusal, or of what is told.
    """

    name: str
    content: bytes | str
    is_read: bool = True
    expected: np.ndarray = field(default_factory=lambda: TABLE)
    units: Mapping[str, str] = field(default_factory=dict)
    rig: str = RIG
    answer: bytes | str | None = None
    tells: str = ""


def shown(value: float, decimal: str = ".") -> str:
    return f"{value:.10g}".replace(".", decimal)


def text(
    header: Sequence[str] | str = HEADER,
    rows: Iterable[Sequence[object]] = TABLE,
    separator: str = ",",
    decimal: str = ".",
    cell: Callable[[float], str] | None = None,
    end: str = "\n",
) -> str:
    """A table as text: below its header, or the lines that stand there, rows of numbers and words."""
    written = io.StringIO()
    writer = csv.writer(written, delimiter=separator, lineterminator=end)
    if isinstance(header, str):
        written.write(header + end)
    else:
        writer.writerow(header)
    formatted = cell or (lambda value: shown(value, decimal))
    writer.writerows([formatted(x) if isinstance(x, float) else x for x in row] for row in rows)
    return written.getvalue()


def columns(header: Sequence[str] | str, *cells: Sequence[object], separator: str = ",") -> str:
    """A table of columns that are no numbers, or not those of `TABLE`."""
    return text(header, zip(*cells, strict=True), separator)


def lines(*parts: str) -> str:
    return "\n".join(parts) + "\n"


def clocks(pattern: str, time_s: np.ndarray = T, **start: int) -> list[str]:
    """Times as clocks show them, from noon of the first of March or another start."""
    noon = datetime.datetime(2026, 3, 1, 12).replace(**start)
    return [(noon + datetime.timedelta(seconds=second)).strftime(pattern) for second in time_s]


def with_nan(*places: tuple[int, int]) -> np.ndarray:
    rows = TABLE.copy()
    rows[tuple(np.transpose(places))] = np.nan
    return rows


def with_times(time_s: np.ndarray) -> np.ndarray:
    return np.column_stack((time_s, TABLE[:, 1:]))


def workbook(sheets: Mapping[str, Sequence[Sequence[object]]]) -> bytes:
    """An .xlsx file by openpyxl; empty where that is missing."""
    try:
        import openpyxl
    except ImportError:
        return b""
    book = openpyxl.Workbook()
    book.remove(book.active)
    for name, rows in sheets.items():
        sheet = book.create_sheet(name)
        for row in rows:
            sheet.append(list(row))
    written = io.BytesIO()
    book.save(written)
    return written.getvalue()


def saved(write: Callable[[Path], None], folder: Path, name: str) -> bytes:
    """What a library writes."""
    path = folder / f"made_{name}"
    write(path)
    return path.read_bytes()


BROKEN_WORKBOOK = b"PK\x03\x04" + struct.pack("<I", 7) + b"xl/workbook.xml"
PLAIN = text()
LINES = PLAIN.splitlines()
COMPRESSED = gzip.compress(PLAIN.encode(), mtime=0)
