"""Importers: from files of readings to sessions. Tables in any form (`forms`), and field maps of public repositories.

`IMPORTERS` gives those of field maps one signature, for the command line: files, rig, and currents by coil (empty if none are given).
An importer is loaded when it is called, so that the command line can list the formats without loading torch.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from estimator.errors import InvalidInput

if TYPE_CHECKING:
    from estimator.rig.rig import Rig
    from estimator.store.session import Session

__all__ = ["IMPORTERS", "Importer"]

Importer: TypeAlias = "Callable[[Sequence[Path], Rig, Mapping[str, float]], Session]"


@dataclass(frozen=True)
class _Function:
    """A function of a module of this package.

    Attributes:
        module, name: Where it is.
        takes_one: Whether it takes one file, instead of a list.
    """

    module: str
    name: str
    takes_one: bool = False

    def __call__(self, paths: Sequence[Path], rig: Rig, currents_A: Mapping[str, float]) -> Session:
        if self.takes_one and len(paths) != 1:
            raise InvalidInput(f"this format takes one file; received {len(paths)}")
        read = getattr(import_module(f"{__name__}.{self.module}"), self.name)
        return read(paths[0] if self.takes_one else paths, rig, currents_A)


IMPORTERS: Mapping[str, Importer] = {
    "mice": _Function("mice", "read_mice", takes_one=True),
    "plane_map": _Function("plane_map", "read_plane_maps"),
    "axis_scan": _Function("axis_scan", "read_axis_scan", takes_one=True),
    "difference_scan": _Function("difference_scan", "read_difference_scan"),
    "grid_maps": _Function("grid_maps", "read_grid_maps"),
}
