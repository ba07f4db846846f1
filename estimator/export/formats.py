"""The formats of `coilcal export`: what each holds, what it asks for, and what makes it.

A maker is a function of a module of this package. It is loaded when it is called, so that the command line can list the formats without
loading torch.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from estimator.errors import InvalidInput, quoted
from estimator.store.staging import write_output

if TYPE_CHECKING:
    from estimator.export.calibrated import Motion
    from estimator.export.magnet import Magnet
    from estimator.export.request import Grid, Request

__all__ = ["FORMATS", "Exportable", "Format", "default_path", "export"]


@dataclass(frozen=True)
class Format:
    """A format.

    Attributes:
        ending: Of the file that is written where none is named.
        words: What the file is, in a few words.
        maker: Module and function that make the content of the file of a `Request`, as text or as bytes.
        takes: What of `grid`, `currents` and `motion` it takes.
    """

    ending: str
    words: str
    maker: str
    takes: tuple[str, ...] = ()

    def content(self, request: Request) -> bytes:
        """Content of the file."""
        module, _, name = self.maker.partition(".")
        made: str | bytes = getattr(import_module(f"estimator.export.{module}"), name)(request)
        return made.encode() if isinstance(made, str) else made


ON_GRID = ("grid", "currents", "motion")
FORMATS: Mapping[str, Format] = {
    "json": Format(".json", "every number of the model, with units", "json_model.json_model"),
    "cpp": Format(".hpp", "C++17 header without dependencies", "cpp_header.cpp_header"),
    "matlab": Format(".m", "function for MATLAB and Octave", "matlab_function.matlab_function"),
    "torch": Format(".pt2", "program of torch.export", "torch_program.program_file"),
    "arviz": Format(".nc", "posterior as NetCDF, for ArviZ", "arviz_netcdf.netcdf"),
    "magpylib": Format(
        ".py",
        "Python module that makes a magpylib collection",
        "magpylib_module.magpylib_module",
        ("motion",),
    ),
    "csv": Format(".csv", "field and gradient on a grid", "grid_csv.grid_csv", ON_GRID),
    "vtk": Format(".vtr", "field and gradient on a grid of VTK, for ParaView", "vtk_grid.vtk_grid", ON_GRID),
    "openpmd": Format(
        ".h5",
        "field and gradient on a grid after openPMD 1.1.0, in HDF5",
        "openpmd_grid.openpmd",
        ON_GRID,
    ),
    "urdf": Format(".urdf", "calibrated frames as a URDF", "frames_urdf.urdf"),
    "tf": Format(
        ".launch.py", "ROS 2 launch file of the calibrated transforms", "frames_urdf.static_transforms"
    ),
    "mag_manip": Format(
        ".yaml", "vfield grid for ETH mag_manip", "mag_manip.vfield_yaml", ("grid", "motion")
    ),
    "mpem": Format(".yaml", "multipoles (MPEM) for ETH mag_manip", "mpem.mpem_yaml", ("grid", "motion")),
}


def export(
    magnet: Magnet,
    to: str,
    path: Path | str | None = None,
    *,
    grid: Grid | None = None,
    currents_A: Mapping[str, float] | None = None,
    motion: Motion | None = None,
    overwrite: bool = True,
) -> Path:
    """Write a calibration, or several as one magnet, in a format for other programs.

    Args:
        magnet: The coils.
        to: A name in `FORMATS`.
        path: File to write; one named after the rig, in the current folder, where none is given.
        grid, currents_A, motion: As in `Request`, for formats that take them.
        overwrite: Replace a file that is there.
    Returns: The file.
    Raises:
        InvalidInput: An unknown format, something it does not take or lacks, a model that it cannot express, or no way to write the file.
    """
    from estimator.export.request import Request

    if to not in FORMATS:
        raise InvalidInput(f"format must be one of {', '.join(FORMATS)}; received {quoted(to)}")
    chosen = FORMATS[to]
    for name, given in (("grid", grid), ("currents", currents_A), ("motion", motion)):
        if given and name not in chosen.takes:
            raise InvalidInput(f"export to {to} must have no {name}, for which it leaves room; received some")
    path = default_path(magnet, to) if path is None else Path(path)
    content = chosen.content(Request(to, magnet, path, grid, currents_A or {}, motion or {}))
    write_output(path, content, overwrite)
    return path


class Exportable(ABC):
    """Coils that can be written for other programs."""

    @abstractmethod
    def magnet(self) -> Magnet:
        """The coils as exports write them."""

    def export(
        self,
        to: str,
        path: Path | str | None = None,
        *,
        grid: Grid | None = None,
        currents_A: Mapping[str, float] | None = None,
        motion: Motion | None = None,
    ) -> Path:
        """Write the model for other programs, as `coilcal export` does (docs/how-to/use-a-calibration-elsewhere.md).

        Args:
            to: Name of a format, such as "cpp". Of several calibrations together only formats with a model or a grid can be made.
            path: File to write; one named after the rig, in the current folder, where none is given.
            grid, currents_A, motion: Points, currents and poses, for formats that take them.
        Returns: The file.
        Raises:
            InvalidInput: An unknown format, something it does not take or lacks, or a model that it cannot express.
        """
        return export(self.magnet(), to, path, grid=grid, currents_A=currents_A, motion=motion)


def default_path(magnet: Magnet, to: str) -> Path:
    """The file that is written where none is named."""
    from estimator.export.labels import identifier

    return Path(f"coilcal_{identifier(magnet.name)}{FORMATS[to].ending}")
