"""Importers of sessions from other formats: the readings CSV, and field maps of public repositories.

`IMPORTERS` gives them all one signature, for the command line: files, rig, and currents by coil (empty if not given).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from estimator.errors import InvalidInput
from estimator.rig.rig import Rig
from estimator.store.importers.axis_scan import read_axis_scan
from estimator.store.importers.difference_scan import read_difference_scan
from estimator.store.importers.mice import read_mice
from estimator.store.importers.plane_map import read_plane_maps
from estimator.store.importers.readings_csv import read_readings_csv, write_readings_csv
from estimator.store.session import Session

__all__ = [
    "IMPORTERS",
    "Importer",
    "read_axis_scan",
    "read_difference_scan",
    "read_mice",
    "read_plane_maps",
    "read_readings_csv",
    "write_readings_csv",
]

Importer = Callable[[Sequence[Path], Rig, Mapping[str, float]], Session]


def _readings(paths: Sequence[Path], rig: Rig, currents_A: Mapping[str, float]) -> Session:
    if currents_A:
        raise InvalidInput(
            f"currents must not be given for a readings CSV, which holds its own; received {', '.join(currents_A)}"
        )
    return read_readings_csv(_only(paths), rig)


def _mice(paths: Sequence[Path], rig: Rig, currents_A: Mapping[str, float]) -> Session:
    return read_mice(_only(paths), rig, currents_A)


def _axis_scan(paths: Sequence[Path], rig: Rig, currents_A: Mapping[str, float]) -> Session:
    return read_axis_scan(_only(paths), rig, currents_A)


def _only(paths: Sequence[Path]) -> Path:
    if len(paths) != 1:
        raise InvalidInput(f"this format takes one file; received {len(paths)}")
    return paths[0]


IMPORTERS: Mapping[str, Importer] = {
    "readings": _readings,
    "mice": _mice,
    "plane_map": read_plane_maps,
    "axis_scan": _axis_scan,
    "difference_scan": read_difference_scan,
}
