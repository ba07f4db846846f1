"""The formats of `coilcal export`: what each holds, what it asks for, and what makes it.

A maker is loaded when it is called, so that the command line can list the formats without loading torch.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from estimator.errors import InvalidInput, quoted
from estimator.store.staging import write_output

if TYPE_CHECKING:
    from estimator.export.calibrated import Motion
    from estimator.export.magnet import Magnet
    from estimator.export.request import Grid, Request

__all__ = ["FORMATS", "Format", "default_path", "export"]


@dataclass(frozen=True)
class Format:
    """A format.

    Attributes:
        ending: Of the file that is written where none is named.
        words: What the file is, in a few words.
        content: Makes the content of the file.
        takes: What of `grid`, `currents` and `motion` it takes.
    """

    ending: str
    words: str
    content: Callable[[Request], bytes]
    takes: tuple[str, ...] = ()


def _json(request: Request) -> bytes:
    from estimator.export.json_model import json_model

    return json_model(request.magnet).encode()


def _cpp(request: Request) -> bytes:
    from estimator.export.cpp_header import cpp_header

    return cpp_header(request.magnet).encode()


def _matlab(request: Request) -> bytes:
    from estimator.export.matlab_function import matlab_function

    return matlab_function(request.magnet, request.path.stem).encode()


def _arviz(request: Request) -> bytes:
    from estimator.export.arviz_netcdf import netcdf

    return netcdf(request.calibrated)


def _magpylib(request: Request) -> bytes:
    from estimator.export.magpylib_module import magpylib_module

    return magpylib_module(request.magnet, request.motion).encode()


def _csv(request: Request) -> bytes:
    from estimator.export.grid_csv import grid_csv

    return grid_csv(request).encode()


def _vtk(request: Request) -> bytes:
    from estimator.export.vtk_grid import vtk_grid

    return vtk_grid(request).encode()


def _openpmd(request: Request) -> bytes:
    from estimator.export.openpmd_grid import openpmd

    return openpmd(request)


def _torch(request: Request) -> bytes:
    from estimator.export.torch_program import program_file

    return program_file(request.magnet)


def _mag_manip(request: Request) -> bytes:
    from estimator.export.mag_manip import vfield_yaml

    return vfield_yaml(request).encode()


def _mpem(request: Request) -> bytes:
    from estimator.export.mpem import mpem_yaml

    return mpem_yaml(request).encode()


def _urdf(request: Request) -> bytes:
    from estimator.export.frames_urdf import urdf

    return urdf(request.calibrated).encode()


def _tf(request: Request) -> bytes:
    from estimator.export.frames_urdf import static_transforms

    return static_transforms(request.calibrated).encode()


FORMATS: Mapping[str, Format] = {
    "json": Format(".json", "every number of the model, with units", _json),
    "cpp": Format(".hpp", "C++17 header without dependencies", _cpp),
    "matlab": Format(".m", "function for MATLAB and Octave", _matlab),
    "torch": Format(".pt2", "program of torch.export", _torch),
    "arviz": Format(".nc", "posterior as NetCDF, for ArviZ", _arviz),
    "magpylib": Format(".py", "Python module that makes a magpylib collection", _magpylib, ("motion",)),
    "csv": Format(".csv", "field and gradient on a grid", _csv, ("grid", "currents", "motion")),
    "vtk": Format(
        ".vtr", "field and gradient on a grid of VTK, for ParaView", _vtk, ("grid", "currents", "motion")
    ),
    "openpmd": Format(
        ".h5",
        "field and gradient on a grid after openPMD 1.1.0, in HDF5",
        _openpmd,
        ("grid", "currents", "motion"),
    ),
    "urdf": Format(".urdf", "calibrated frames as a URDF", _urdf),
    "tf": Format(".launch.py", "ROS 2 launch file of the calibrated transforms", _tf),
    "mag_manip": Format(".yaml", "vfield grid for ETH mag_manip", _mag_manip, ("grid", "motion")),
    "mpem": Format(".yaml", "multipoles (MPEM) for ETH mag_manip", _mpem, ("grid", "motion")),
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


def default_path(magnet: Magnet, to: str) -> Path:
    """The file that is written where none is named."""
    from estimator.export.labels import identifier

    return Path(f"coilcal_{identifier(magnet.name)}{FORMATS[to].ending}")
