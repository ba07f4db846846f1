"""What a file or folder of coilcal is.

A kind of folder is recognised by names of files, which are stated here: what reads the folder is loaded once it is known to be one.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from estimator.errors import InvalidInput
from estimator.store.importers.csv_lines import cells_of, csv_blocks
from estimator.store.session import is_growing, is_session
from estimator.units import split_unit
from estimator.yaml_section import Section

# Of the modules that write them; a test holds each together with its own.
SUMMARY_FILE, CHAIN_STORE = "summary.json", "chain.zarr"  # `calibration.files`
DIAGNOSIS, CALIBRATION_FOLDER = "diagnosis.json", "calibration"  # `diagnosis.result`
UNKNOWN = "something not in the library"  # `diagnosis.verdict`
VERSIONS, LOG = "versions", "log.jsonl"  # `recalibration.registry`
JOBS, RESULT_FILE = "jobs", "result.json"  # `batching`, which needs an extra
DATABASE = "coilcal.sqlite"  # `service`, likewise
FIELD = ("Bx", "By", "Bz")  # `store.importers.table_readings`
MARKS: dict[str, Callable[[Path], bool]] = {
    "session that grows": is_growing,
    "session": is_session,
    "diagnosis": lambda path: (path / DIAGNOSIS).is_file(),
    "calibration": lambda path: (path / SUMMARY_FILE).is_file(),
    "unfinished calibration": lambda path: (path / CHAIN_STORE).is_dir(),
    "registry": lambda path: (path / LOG).is_file() or (path / VERSIONS).is_dir(),
    "data of the service": lambda path: (path / DATABASE).is_file(),
    "batch": lambda path: any((path / JOBS).glob(f"*/{RESULT_FILE}")),
}


def kind_of(path: Path) -> str | None:
    """What a path is, by the files that mark it; None where it is nothing of coilcal."""
    if path.is_file():
        return _kind_of_file(path)
    if not path.is_dir():
        rule = "be a file or a folder" if path.exists() else "exist"
        raise InvalidInput(f"path must {rule}; received {path}")
    kind = next((kind for kind, is_there in MARKS.items() if is_there(path)), None)
    if kind is None and any(known_inside(path)):
        return "folder"
    return kind


def _kind_of_file(path: Path) -> str | None:
    if path.suffix == ".csv":
        return _kind_of_csv(path)
    if path.suffix not in (".yaml", ".yml"):
        return None
    top = Section.from_file(path)
    if "coils" in top or "sensors" in top:
        return "rig file"
    return "plan" if "poses" in top or "stops" in top else None


def _kind_of_csv(path: Path) -> str | None:
    header, _ = csv_size(path)
    if "inside_winding" in header:
        return "field CSV"
    return "readings CSV" if {split_unit(name.strip())[0] for name in header} & set(FIELD) else None


def csv_size(path: Path) -> tuple[list[str], int]:
    """Header and number of rows."""
    header: list[str] = []
    n_lines = 0
    for block in csv_blocks(path):
        if not n_lines and block.texts:
            header = cells_of(block.texts[0], path, block.numbers[0])
        n_lines += len(block.texts)
    return header, max(n_lines - 1, 0)


def known_inside(folder: Path) -> list[tuple[str, str]]:
    """Name and kind of what coilcal knows among the entries of a folder; not of those of folders in it."""
    inside = []
    for path in sorted(folder.iterdir()):
        is_marked = any(is_there(path) for is_there in MARKS.values())
        try:
            kind = None if path.is_dir() and (path.is_symlink() or not is_marked) else kind_of(path)
        except InvalidInput:
            kind = None
        if kind is not None:
            inside.append((path.name, kind))
    return inside
