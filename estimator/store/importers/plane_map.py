"""Imports plane maps of a pair of coils, one signed reading per point: the Maxwell pair of sassafras13/steering_magnetic_robots.

A file holds 14 rows by 11 columns in gauss. As in the source's plotting code (plotBFieldData.m, MIT licence), columns are the axial
coordinate from -5 to 5 cm, and rows the transverse one from -6 to 7 cm.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from jaxtyping import Float

from estimator.errors import InvalidInput
from estimator.rig.rig import Rig
from estimator.store.importers.common import check_one_sensor, current_by_coil, map_observations, read_numbers
from estimator.store.session import Session
from estimator.tensors import Tensor, torch
from estimator.units import UNITS

AXIAL_M, TRANSVERSE_M = (-0.05, 0.05, 11), (-0.06, 0.07, 14)  # first, last and number of places
NAME = re.compile(r"u1_(-?\d+(?:_\d+)?)_u2_(-?\d+(?:_\d+)?)_r(\d+)$")


def read_plane_maps(
    paths: Sequence[Path], rig: Rig, currents_A: Mapping[str, float] | None = None
) -> Session:
    """Read maps of one pair of coils, with their repeats and currents, into one session.

    The single component is taken to be the axial one, sensor z; the source does not state which one the probe measured. The files hold
    no times, so `time_s` counts the readings. Each file is a segment.

    Args:
        paths: Files named u1_<ampere>_u2_<ampere>_r<repeat>.csv, with _ for the decimal point.
        rig: Must have one pose mover, which carries the sensor in the plane x-z with axis z; the first coil is u1, the second u2.
        currents_A: Current of each coil, the same for every file; taken from the file names if not given.
    Raises:
        InvalidInput: There is no file, a file has another shape, or a name has no currents.
    """
    if not paths:
        raise InvalidInput("plane maps must be at least one file; received none")
    check_one_sensor(rig)
    maps = [_map_T(path) for path in paths]
    settings = [_setting(path, rig, currents_A) for path in paths]
    n_points = maps[0].numel()
    transverse_m, axial_m = torch.meshgrid(
        *(torch.linspace(*places, dtype=torch.float64) for places in (TRANSVERSE_M, AXIAL_M)), indexing="ij"
    )
    pose = torch.zeros(n_points, 6, dtype=torch.float64)
    pose[:, 0], pose[:, 2] = transverse_m.flatten(), axial_m.flatten()
    field_T = torch.full((n_points * len(maps), 3), torch.nan, dtype=torch.float64)
    field_T[:, 2] = torch.cat([map_T.flatten() for map_T in maps])
    observations = map_observations(
        rig,
        torch.tensor([current for current, _ in settings], dtype=torch.float64).repeat_interleave(
            n_points, dim=0
        ),
        pose.repeat(len(maps), 1),
        field_T,
        repeat=torch.tensor([repeat for _, repeat in settings]).repeat_interleave(n_points),
    )
    segment = torch.arange(len(maps)).repeat_interleave(n_points)
    return Session(
        rig,
        replace(observations, recorded_segment=segment),
        f"plane maps {', '.join(path.name for path in paths)}; t_s counts the readings",
    )


def _map_T(path: Path) -> Float[Tensor, "transverse axial"]:
    table = read_numbers(path, separator=",", header_lines=1)
    shape = (TRANSVERSE_M[-1], 1 + AXIAL_M[-1])
    if table.shape != shape:
        raise InvalidInput(
            f"{path} must hold {shape[0]} rows of {shape[1]} cells; it holds {tuple(table.shape)}"
        )
    return table[:, 1:] * UNITS["G"].to_si


def _setting(path: Path, rig: Rig, currents_A: Mapping[str, float] | None) -> tuple[list[float], int]:
    """Currents and repeat number of a file; the repeat is 0 if the name has another form."""
    match = NAME.match(path.stem)
    repeat = int(match[3]) if match else 0
    if currents_A:
        return current_by_coil(rig, currents_A), repeat
    if match is None:
        raise InvalidInput(
            f"file name must read u1_<ampere>_u2_<ampere>_r<repeat>, or currents be given; received {path.name}"
        )
    if len(rig.coils) != 2:
        raise InvalidInput(f"rig {rig.name!r} must have two coils, u1 and u2; it has {len(rig.coils)}")
    return [float(match[i].replace("_", ".")) for i in (1, 2)], repeat
