"""Importers: from files of readings to sessions. Our own CSV, and field maps of public repositories.

`IMPORTERS` gives all of them one signature, for the command line: files, rig, and currents by coil (empty if none are given). An importer
is loaded when it is called, so that the command line can list the formats without loading torch.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from estimator.errors import InvalidInput

if TYPE_CHECKING:
    from estimator.rig.rig import Rig
    from estimator.store.session import Session

__all__ = ["IMPORTERS", "Importer"]

Importer: TypeAlias = "Callable[[Sequence[Path], Rig, Mapping[str, float]], Session]"


def _readings(paths: Sequence[Path], rig: Rig, currents_A: Mapping[str, float]) -> Session:
    from estimator.store.importers.readings_csv import read_readings_csv

    if currents_A:
        raise InvalidInput(
            f"currents must not be given for a readings CSV, which holds its own; received {', '.join(currents_A)}"
        )
    return read_readings_csv(_only(paths), rig)


def _mice(paths: Sequence[Path], rig: Rig, currents_A: Mapping[str, float]) -> Session:
    from estimator.store.importers.mice import read_mice

    return read_mice(_only(paths), rig, currents_A)


def _plane_map(paths: Sequence[Path], rig: Rig, currents_A: Mapping[str, float]) -> Session:
    from estimator.store.importers.plane_map import read_plane_maps

    return read_plane_maps(paths, rig, currents_A)


def _axis_scan(paths: Sequence[Path], rig: Rig, currents_A: Mapping[str, float]) -> Session:
    from estimator.store.importers.axis_scan import read_axis_scan

    return read_axis_scan(_only(paths), rig, currents_A)


def _difference_scan(paths: Sequence[Path], rig: Rig, currents_A: Mapping[str, float]) -> Session:
    from estimator.store.importers.difference_scan import read_difference_scan

    return read_difference_scan(paths, rig, currents_A)


def _grid_maps(paths: Sequence[Path], rig: Rig, currents_A: Mapping[str, float]) -> Session:
    from estimator.store.importers.grid_maps import read_grid_maps

    return read_grid_maps(paths, rig, currents_A)


def _only(paths: Sequence[Path]) -> Path:
    if len(paths) != 1:
        raise InvalidInput(f"this format takes one file; received {len(paths)}")
    return paths[0]


IMPORTERS: Mapping[str, Importer] = {
    "readings": _readings,
    "mice": _mice,
    "plane_map": _plane_map,
    "axis_scan": _axis_scan,
    "difference_scan": _difference_scan,
    "grid_maps": _grid_maps,
}
