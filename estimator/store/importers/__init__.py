"""Importers: from files of readings to sessions. Our own CSV, and field maps of public repositories.

`IMPORTERS` gives all of them one signature, for the command line: files, rig, and currents by coil (empty if none are given). An importer
is loaded when it is called, so that the command line can list the formats without loading torch.
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
        takes_currents: Whether it takes currents by coil.
    """

    module: str
    name: str
    takes_one: bool = False
    takes_currents: bool = True

    def __call__(self, paths: Sequence[Path], rig: Rig, currents_A: Mapping[str, float]) -> Session:
        if currents_A and not self.takes_currents:
            names = ", ".join(currents_A)
            raise InvalidInput(
                f"currents must not be given for a readings CSV, which holds its own; received {names}"
            )
        if self.takes_one and len(paths) != 1:
            raise InvalidInput(f"this format takes one file; received {len(paths)}")
        read = getattr(import_module(f"{__name__}.{self.module}"), self.name)
        currents = [currents_A] if self.takes_currents else []
        session: Session = read(paths[0] if self.takes_one else paths, rig, *currents)
        return session


IMPORTERS: Mapping[str, Importer] = {
    "readings": _Function("readings_csv", "read_readings_csv", takes_one=True, takes_currents=False),
    "mice": _Function("mice", "read_mice", takes_one=True),
    "plane_map": _Function("plane_map", "read_plane_maps"),
    "axis_scan": _Function("axis_scan", "read_axis_scan", takes_one=True),
    "difference_scan": _Function("difference_scan", "read_difference_scan"),
    "grid_maps": _Function("grid_maps", "read_grid_maps"),
}
