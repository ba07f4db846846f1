"""What kind of file it is, by its first bytes, and the rows of those that are no text: workbooks, HDF5, MATLAB, NumPy, JSON, Parquet."""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, time
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from estimator.errors import CoilcalError, InvalidInput, closest, quoted
from estimator.given_files import MOST_TABLE_BYTES, open_given, read_given
from estimator.store.importers.csv_lines import Block
from estimator.store.importers.forms.records import columns_in
from estimator.store.importers.forms.units import split_file_unit

CELL_SEPARATOR = "\x1f"  # which no cell holds
MOST_COLUMNS = 1000
TEXT_FIRST = 512  # bytes by which kinds are told


@dataclass(frozen=True)
class Grid:
    """Rows of a file that is no text.

    Attributes:
        block: Its cells as lines.
        name: Of the sheet or table.
        others: Names of the others.
    """

    block: Block
    name: str
    others: tuple[str, ...]


def kind_of(path: Path) -> str:
    """The kind of a file: text, workbook, hdf5, matlab, npy, npz, json or parquet.

    Raises:
        InvalidInput: It cannot be read, or is of a kind that coilcal does not read; the sentence says what to do.
    """
    with open_given(path, MOST_TABLE_BYTES, rule="must be readable as text") as file:
        first = file.read(TEXT_FIRST)
    for magic, kind in MAGIC.items():
        if first.startswith(magic):
            return kind
    if JSON.match(first):
        return "json"
    for magic, cure in OTHERS.items():
        if first.startswith(magic):
            raise InvalidInput(f"{path} must be a table of readings; it is {cure}")
    if not first.startswith(b"PK\x03\x04"):
        return "text"
    try:
        with zipfile.ZipFile(io.BytesIO(read_given(path, MOST_TABLE_BYTES))) as archive:
            names = archive.namelist()
    except zipfile.BadZipFile:
        raise InvalidInput(
            f"{path} must be a whole workbook; it is damaged: save it again, or export it as CSV"
        ) from None
    if any(name.endswith(".npy") for name in names):
        return "npz"
    if "xl/workbook.xml" in names:
        return "workbook"
    raise InvalidInput(
        f"{path} must be a table of readings; it is an archive or another program's file: export it as CSV"
    )


JSON = re.compile(rb"(?:\xef\xbb\xbf)?\s*(?:\{\s*\"|\[\s*\{)")
MAGIC = {b"\x89HDF\r\n\x1a\n": "hdf5", b"MATLAB 5.0": "matlab", b"\x93NUMPY": "npy", b"PAR1": "parquet"}
OTHERS = {
    b"\xd0\xcf\x11\xe0": "an old workbook (.xls): save it as .xlsx or CSV",
    b"#ROSBAG": "a ROS bag: export its topic as CSV, with rostopic echo -b FILE -p /TOPIC > readings.csv",
    b"\x89MCAP0": "a ROS bag: play it, and export its topic with ros2 topic echo --csv /TOPIC > readings.csv",
    b"SQLite format 3": "a database or a ROS bag: export the table as CSV",
    b"\x1f\x8b": "compressed: unpack it with gunzip",
    b"%PDF": "a PDF: export the table as CSV",
}


def grid_of(path: Path, kind: str, sheet: str | None, is_table: Callable[[Block], bool]) -> Grid:
    """The rows of a file that is no text.

    Args:
        path, kind: As `kind_of` has told it.
        sheet: Of a workbook; None for the first that holds a table.
        is_table: Whether rows are a table of numbers.
    Raises:
        InvalidInput: It cannot be read, or holds no table; or a library is missing.
    """
    try:
        if kind == "workbook":
            return _workbook(path, sheet, is_table)
        return Grid(_of_columns(path, READERS[kind](path)), path.name, ())
    except CoilcalError:
        raise
    except Exception as error:  # libraries raise whatever a damaged file leads them to
        what = "a whole workbook" if kind == "workbook" else "a whole file of arrays"
        words = f"{path} must be {what}; it is damaged or unusual: save it again, or export it as CSV"
        raise InvalidInput(words) from error


def _workbook(path: Path, sheet: str | None, is_table: Callable[[Block], bool]) -> Grid:
    try:
        import openpyxl
    except ImportError:
        raise _missing(path, "workbooks") from None
    content = io.BytesIO(read_given(path, MOST_TABLE_BYTES))
    book = openpyxl.load_workbook(content, read_only=True, data_only=True)
    names = [each.title for each in book.worksheets]
    if sheet is not None and sheet not in names:
        raise InvalidInput(
            f"--sheet must be one of {', '.join(map(quoted, names))}; received {quoted(sheet)}{closest(sheet, names)} ({path})"
        )
    for each in book.worksheets:
        if sheet in {None, each.title}:
            rows = (
                [_cell(value) for value in row[:MOST_COLUMNS]] for row in each.iter_rows(values_only=True)
            )
            block = _of_rows(path, rows)
            if sheet is not None or is_table(block):
                return Grid(block, each.title, tuple(name for name in names if name != each.title))
    raise InvalidInput(f"{path} must hold a sheet with a table of numbers; none of {len(names)} does")


def _cell(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, datetime | time):
        return value.isoformat()
    if isinstance(value, float) and value.is_integer() and abs(value) < 1e15:
        return str(int(value))
    return " ".join(str(value).split())


def _of_rows(path: Path, rows: Iterator[Sequence[str]]) -> Block:
    texts, numbers = [], []
    for number, row in enumerate(rows, start=1):
        text = CELL_SEPARATOR.join(cell.replace(CELL_SEPARATOR, " ").replace('"', "'") for cell in row)
        if text.strip(CELL_SEPARATOR):
            texts.append(text.replace("\0", ""))
            numbers.append(number)
    return Block(path, texts, numbers, True, CELL_SEPARATOR)


def _of_columns(path: Path, columns: Mapping[str, npt.NDArray[Any]]) -> Block:
    """Columns of one length as rows with a header; those of other lengths are left out."""
    lengths = [len(values) for values in columns.values()]
    if not lengths:
        raise InvalidInput(f"{path} must hold arrays of one number for each reading; it holds none")
    length = max(set(lengths), key=lambda each: (lengths.count(each), each))
    chosen = {name: values for name, values in columns.items() if len(values) == length}
    cells = [[_cell(value) for value in values.tolist()] for values in chosen.values()]

    def rows() -> Iterator[Sequence[str]]:
        yield list(chosen)
        yield from zip(*cells, strict=True)

    return _of_rows(path, rows())


def _flat(name: str, values: npt.NDArray[Any], unit: str = "") -> dict[str, npt.NDArray[Any]]:
    """An array as columns: a record by its fields, three components as x, y, z, more by number."""
    after = f" [{unit}]" if unit else ""
    if values.dtype.names:
        return {
            key: column for field in values.dtype.names for key, column in _flat(field, values[field]).items()
        }
    if values.dtype.kind == "S":
        values = np.char.decode(values, "utf-8", "replace")
    if values.ndim == 2 and 1 in values.shape:
        values = values.reshape(-1)
    if values.ndim == 1 and values.dtype.kind in "biufUO":
        return {f"{name}{after}": values}
    if values.ndim != 2 or values.dtype.kind not in "biuf":
        return {}
    if values.shape[0] == 3 < values.shape[1]:
        values = values.T
    ends = "xyz" if values.shape[1] == 3 else [str(i) for i in range(min(values.shape[1], MOST_COLUMNS))]
    quantity, suffix = split_file_unit(name)  # position_mm becomes position_x_mm
    after = after if suffix is None else f"_{suffix.symbol}"
    return {f"{quantity}_{end}{after}": values[:, i] for i, end in enumerate(ends)}


def _hdf5(path: Path) -> dict[str, npt.NDArray[Any]]:
    import h5py

    columns: dict[str, npt.NDArray[Any]] = {}
    with h5py.File(path, "r") as file:

        def visit(name: str, item: Any) -> None:
            if isinstance(item, h5py.Dataset) and item.ndim in {1, 2} and item.size:
                unit = next(
                    (item.attrs[key] for key in ("unit", "units", "Unit", "Units") if key in item.attrs), ""
                )
                unit = unit.decode() if isinstance(unit, bytes) else str(unit)
                columns.update(_flat(name.rpartition("/")[2], item[()], unit))

        file.visititems(visit)
    return columns


def _matlab(path: Path) -> dict[str, npt.NDArray[Any]]:
    from scipy.io import loadmat

    columns: dict[str, npt.NDArray[Any]] = {}
    for name, values in loadmat(path, squeeze_me=True).items():
        if not name.startswith("__") and isinstance(values, np.ndarray):
            columns |= _flat(name, values)
    return columns


def _numpy(path: Path) -> dict[str, npt.NDArray[Any]]:
    loaded = np.load(path, allow_pickle=False)
    if isinstance(loaded, np.ndarray):
        if not loaded.dtype.names:
            raise InvalidInput(
                f"{path} must name its columns; it is an array without names: save it with np.savez(FILE, t_s=..., Bx_T=...)"
            )
        return _flat("", loaded)
    with loaded:
        columns: dict[str, npt.NDArray[Any]] = {}
        for name in loaded.files:
            columns |= _flat(name, loaded[name])
    return columns


def _parquet(path: Path) -> dict[str, npt.NDArray[Any]]:
    try:
        import pyarrow.parquet
    except ImportError:
        raise _missing(path, "Parquet files") from None
    table = pyarrow.parquet.read_table(path)
    columns: dict[str, npt.NDArray[Any]] = {}
    for name in table.column_names:
        values = table.column(name).to_pylist()
        columns[name] = np.array(["" if value is None else _cell(value) for value in values], dtype=object)
    return columns


def _json(path: Path) -> dict[str, npt.NDArray[Any]]:
    columns: dict[str, npt.NDArray[Any]] = {}
    for name, values in columns_in(read_given(path, MOST_TABLE_BYTES).decode("utf-8-sig")).items():
        is_vector = all(isinstance(value, list) for value in values)
        columns |= _flat(name, np.array(values, dtype=None if is_vector else object))
    return columns


READERS: Mapping[str, Callable[[Path], dict[str, npt.NDArray[Any]]]] = {
    "hdf5": _hdf5,
    "matlab": _matlab,
    "json": _json,
    "npz": _numpy,
    "npy": _numpy,
    "parquet": _parquet,
}


def _missing(path: Path, what: str) -> InvalidInput:
    return InvalidInput(
        f"{what} need another package; install it with: pip install 'coilcal[files]' ({path})"
    )


def renumbered(block: Block, first_line: int) -> Block:
    """The block from a line on."""
    at = next((i for i, number in enumerate(block.numbers) if number >= first_line), len(block.numbers))
    return replace(block, texts=block.texts[at:], numbers=block.numbers[at:])
