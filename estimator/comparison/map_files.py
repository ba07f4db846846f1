"""Field maps of other programs: full grids as CSV with a header, what COMSOL exports, or grids of VTK."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from estimator.comparison.vtk_maps import SUFFIXES, read_vtk
from estimator.errors import InvalidInput, Place, quoted
from estimator.field.grid_map import GridMap
from estimator.given_files import read_given, read_given_text
from estimator.store.importers.csv_lines import cells_of
from estimator.units import LARGEST, UNITS

SEPARATORS = re.compile(r"[;,\t]|\s{2,}")
COLUMN = re.compile(
    r"^(?:.*\.)?(?P<name>[xyzXYZ]|B_?[xyz])\s*(?:[_ ]\s*)?(?:\(?(?P<unit>[mcun\u00b5\u03bc]?[mTG])\)?)?(?:\s*@.*)?$"
)
LENGTH_UNIT = re.compile(r"^%\s*Length unit\W+(\w+)", re.MULTILINE)
MOST_BYTES = 400_000_000
SAME = 1e-6  # of the spacing: coordinates that differ by less are one


@dataclass(frozen=True)
class Column:
    """Column of a table that holds one quantity, and the factor that takes its numbers to SI."""

    index: int
    to_si: float


class Line(NamedTuple):
    """A line of a file, and its number from 1."""

    number: int
    text: str


def read_map(path: Path, current_A: float) -> GridMap:
    """The map per ampere.

    A grid of VTK (`.vti`, `.vtr`) has point data `B` in tesla at coordinates in metres. In a CSV, columns are x, y, z and Bx, By, Bz with
    a unit each, as `x_mm` or `mf.Bx (T)`. A coordinate without one has that of COMSOL's line `% Length unit`.

    Args:
        path: The file.
        current_A: Current at which it was computed.
    Raises:
        InvalidInput: The file cannot be read, a column is missing or has no unit, the points are no full grid, or a field is missing.
    """
    if path.suffix in SUFFIXES:
        return _of_vtk(path, current_A)
    text = read_given_text(path, MOST_BYTES)
    comments, rows = [], []
    for number, line in enumerate(text.replace("\r\n", "\n").replace("\r", "\n").split("\n"), start=1):
        if line.startswith("%"):
            comments.append(Line(number, line.lstrip("% ")))
        elif line.strip():
            rows.append(Line(number, line))
    header = comments[-1] if comments else rows.pop(0) if rows else Line(1, "")
    columns = _columns(_cells(header, path), LENGTH_UNIT.search(text), path)
    numbers = _numbers(rows, columns, path)
    return _on_grid(numbers[:, :3], numbers[:, 3:] / current_A, path)


def _of_vtk(path: Path, current_A: float) -> GridMap:
    points_m, field_T = read_vtk(path, read_given(path, MOST_BYTES))
    n_missing = int((~(np.abs(field_T) <= LARGEST)).any(1).sum())
    if n_missing:
        raise InvalidInput(f"field map must be finite; {n_missing} points are not ({path})")
    return _on_grid(points_m, field_T / current_A, path)


def _cells(line: Line, path: Path) -> list[str]:
    text = line.text
    parts = cells_of(text, path, line.number) if "," in text else SEPARATORS.split(text.strip())
    return [part.strip() for part in parts]


def _columns(cells: list[str], length: re.Match[str] | None, path: Path) -> list[Column]:
    columns: dict[str, Column] = {}
    for index, cell in enumerate(cells):
        match = COLUMN.match(cell)
        if match is None:
            continue
        name = match["name"].replace("_", "")
        name = name if name.startswith("B") else name.lower()  # of the material frame, COMSOL writes X, Y, Z
        symbol = (
            (match["unit"] or (length[1] if length and name in "xyz" else ""))
            .replace("\u00b5", "u")
            .replace("\u03bc", "u")
        )
        unit = UNITS.get(symbol)
        if unit is None or unit.dimension != ("length" if name in "xyz" else "field"):
            raise InvalidInput(
                f"column of a field map must have a unit, as x_mm or Bx (T); received {quoted(cell)} ({path})"
            )
        columns[name] = Column(index, unit.to_si)
    wanted = ("x", "y", "z", "Bx", "By", "Bz")
    missing = [name for name in wanted if name not in columns]
    if missing:
        raise InvalidInput(
            f"field map must have columns x, y, z, Bx, By, Bz with units; {missing[0]} is missing ({path})"
        )
    return [columns[name] for name in wanted]


def _numbers(rows: list[Line], columns: list[Column], path: Path) -> np.ndarray:
    """The six columns in SI."""
    wanted, factors = [column.index for column in columns], [column.to_si for column in columns]
    table = np.empty((len(rows), len(wanted)))
    for i, (number, row) in enumerate(rows):
        cells = (
            row.split(",")
            if "," in row
            else SEPARATORS.split(row.strip())
            if ";" in row or "\t" in row
            else row.split()
        )
        try:
            table[i] = [float(cells[index]) for index in wanted]
        except (ValueError, IndexError) as error:
            words = f"row of a field map must hold numbers; received {quoted(row)}"
            raise InvalidInput.at(Place(str(path), number), words) from error
    is_wrong = ~(np.abs(table) <= LARGEST).all(1)
    if is_wrong.any():
        rule = f"field map must hold finite numbers between {-LARGEST:g} and {LARGEST:g}"
        first = rows[int(is_wrong.argmax())].number
        raise InvalidInput(f"{rule}; {int(is_wrong.sum())} rows do not ({path}, the first in line {first})")
    return table * factors


def _on_grid(points_m: np.ndarray, values: np.ndarray, path: Path) -> GridMap:
    """The rows in the order of the grid."""
    axes_m, rows = [], []
    for column in points_m.T:
        ordered = np.unique(column)
        step_m = (ordered[-1] - ordered[0]) / max(len(ordered) - 1, 1) if len(ordered) else 0.0
        is_new = np.diff(ordered, prepend=-np.inf) > SAME * step_m
        axes_m.append(ordered[is_new])
        rows.append(np.searchsorted(axes_m[-1], column + SAME * step_m, side="right") - 1)
    shape = tuple(map(len, axes_m))
    flat = np.ravel_multi_index(tuple(rows), shape) if len(points_m) else np.zeros(0, dtype=int)
    if len(points_m) != np.prod(shape) or len(np.unique(flat)) != len(flat):
        raise InvalidInput(
            f"field map must hold every point of a grid once; {path} has {len(points_m)} rows for {' x '.join(map(str, shape))} points"
        )
    field = np.empty((len(flat), 3))
    field[flat] = values
    return GridMap.of((axes_m[0], axes_m[1], axes_m[2]), field.reshape(*shape, 3))
