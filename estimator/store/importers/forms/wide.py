"""A table with the fields of several sensors beside each other becomes one row for each reading of one sensor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from estimator.rig.rig import Rig
from estimator.store.importers.table import Cells, HeaderCell, Table

COMPONENTS = ("Bx", "By", "Bz")


def lengthened(table: Table, rig: Rig) -> Table:
    """The table with one row for each sensor that has columns of its own; others are as they were."""
    names = [
        sensor.name for sensor in rig.sensors if any(f"{sensor.name}_{axis}" in table for axis in COMPONENTS)
    ]
    if not names or len(rig.sensors) == 1:
        return table
    n_rows, n_sensors = len(table.lines), len(names)
    rows = np.repeat(np.arange(n_rows), n_sensors)
    own = {f"{name}_{axis}" for name in names for axis in COMPONENTS}
    columns = {key: _taken(cells, rows) for key, cells in table.columns.items() if key not in own}
    header = {key: cell for key, cell in table.header.items() if key not in own}
    for axis in COMPONENTS:
        parts = [table.columns.get(f"{name}_{axis}") for name in names]
        if any(part is not None for part in parts):
            columns[axis] = _interleaved(
                parts, [table.header.get(f"{name}_{axis}") for name in names], n_rows
            )
            header[axis] = HeaderCell(_first_column(table, names, axis), axis, 1.0)
    columns["sensor"] = Cells(None, {}, names, np.tile(np.arange(n_sensors, dtype=np.int32), n_rows))
    header["sensor"] = HeaderCell(-1, "sensor", 1.0)
    return replace(table, columns=columns, header=header, lines=table.lines[rows])


def _first_column(table: Table, names: list[str], axis: str) -> int:
    return min(table.header[f"{name}_{axis}"].column for name in names if f"{name}_{axis}" in table)


def _taken(cells: Cells, rows: npt.NDArray[np.intp]) -> Cells:
    """Cells of rows that may be taken several times."""
    if cells.numbers is None:
        return replace(cells, codes=cells.codes[rows])
    refused = {i: cells.refused[row] for i, row in enumerate(rows.tolist()) if row in cells.refused}
    return replace(cells, numbers=cells.numbers[rows], refused=refused)


def _interleaved(parts: list[Cells | None], headers: list[HeaderCell | None], n_rows: int) -> Cells:
    """Columns of several sensors in SI, one after another in each row; nothing where a sensor has none."""
    numbers = np.full((n_rows, len(parts)), np.nan)
    refused: dict[int, str] = {}
    for i, (part, cell) in enumerate(zip(parts, headers, strict=True)):
        if part is not None and cell is not None and part.numbers is not None:
            numbers[:, i] = part.numbers * cell.to_si
            refused |= {row * len(parts) + i: text for row, text in part.refused.items()}
    return replace(Cells.of_numbers(numbers.reshape(-1)), refused=refused)
