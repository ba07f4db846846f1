"""Data frames as files of readings: any table that names its columns and gives each as an array."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from estimator.errors import InvalidInput, quoted
from estimator.rig.rig import Rig
from estimator.store.importers.csv_lines import Block
from estimator.store.importers.forms.recipe import Recipe
from estimator.store.importers.forms.sources import CELL_SEPARATOR
from estimator.store.importers.forms.understand import understood_block
from estimator.store.importers.table_readings import Recorded


def readings_of_frame(
    frame: Any, rig: Rig, columns: dict[str, str], constants: dict[str, float], source: str
) -> Recorded:
    """Readings of a data frame, before they are checked.

    Args:
        frame: Of pandas or polars, or a mapping of columns.
        rig: Determines the columns.
        columns, constants: As in a recipe.
        source: Stands in for the name of a file in messages.
    Raises:
        InvalidInput: It is no data frame, or its columns cannot be read.
    """
    cells = _columns(frame)
    if len({len(column) for column in cells.values()}) > 1:
        lengths = ", ".join(f"{name} {len(column)}" for name, column in list(cells.items())[:6])
        raise InvalidInput(f"columns of the data frame must be equally long; received {lengths} ({source})")
    rows = [CELL_SEPARATOR.join(row) for row in (list(cells), *zip(*cells.values(), strict=True))]
    block = Block(Path(source), rows, range(len(rows)), True, CELL_SEPARATOR)
    try:
        readings = understood_block(block, rig, Recipe(columns=columns, constants=constants)).readings
    except InvalidInput as refusal:
        raise InvalidInput(_for_python(str(refusal))) from refusal
    # A row of a frame is no line of a file.
    return readings._replace(observations=replace(readings.observations, line=None), source=source)


def _for_python(words: str) -> str:
    """A refusal of an import with arguments in place of options.

    Examples:
        >>> _for_python("name it with --column 'Probe=Bx_UNIT', or --constant coil1_current_A=AMPERE (data frame, line 0)")
        "name it with columns={'Probe': 'Bx_UNIT'}, or constants={'coil1_current_A': AMPERE} (data frame)"
    """
    words = re.sub(r"--column '([^']+)=([^'=]+)'", r"columns={'\1': '\2'}", words)
    words = re.sub(r"--constant (\w+)=(\w+)", r"constants={'\1': \2}", words)
    return words.replace(", line 0)", ")")


def _columns(frame: Any) -> dict[str, list[str]]:
    """Cells of each column as text."""
    names = getattr(frame, "columns", None)
    if names is None and hasattr(frame, "keys"):
        names = list(frame.keys())
    if names is None:
        raise InvalidInput(
            f"frame must be a data frame, or a mapping of columns such as {{'Bx_mT': [...]}}; received {quoted(type(frame).__name__)}"
        )
    return {str(name): _texts(frame[name]) for name in names}


def _texts(column: Any) -> list[str]:
    array = column.to_numpy() if hasattr(column, "to_numpy") else np.asarray(column)
    if np.issubdtype(array.dtype, np.datetime64):
        return [str(stamp).replace("T", " ") for stamp in array.astype("datetime64[us]")]
    if np.issubdtype(array.dtype, np.number):
        return ["" if np.isnan(value) else repr(value) for value in array.astype(float).tolist()]
    is_missing = [value is None or (isinstance(value, float) and np.isnan(value)) for value in array.tolist()]
    return ["" if missing else str(value) for missing, value in zip(is_missing, array.tolist(), strict=True)]
