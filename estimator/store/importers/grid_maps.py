"""Imports fields of single coils on grids, per ampere: `vfield_<number>.txt` of ethz-msrl/Tesla_core_public (eight coils with iron cores).

A file starts with the number of points, the points along each axis and the range of each axis; then come rows `x y z Bx By Bz` in metre
and tesla. The source says that such files are either a scan with a magnetometer or a computation by finite elements, and not which.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from jaxtyping import Float

from estimator.errors import InvalidInput, check_known
from estimator.rig.rig import Rig
from estimator.store.importers.common import check_one_sensor, map_observations, read_lines, read_numbers
from estimator.store.session import Session
from estimator.tensors import Tensor, torch

NAME = re.compile(r"vfield_(\d+)$")
HEADER_LINES = 5
ROUNDING = 1e-3  # of the range of an axis
PROVENANCE = "a scan with a magnetometer or finite elements; the source does not say which"


def read_grid_maps(paths: Sequence[Path], rig: Rig, currents_A: Mapping[str, float] | None = None) -> Session:
    """Read the maps of some coils, one at a time on, into one session.

    The files hold no times, so `time_s` counts the readings. Each file is a segment.

    Args:
        paths: Files named vfield_<number>.txt; number 0 is the first coil of the rig.
        rig: Must have one sensor, on a mover that reports poses.
        currents_A: Current of each coil, at which its map is read as it stands; 1 A for all if not given.
    Raises:
        InvalidInput: There is no file, a name tells no coil of the rig, or a file has not the points that its header says.
    """
    if not paths:
        raise InvalidInput("grid maps must be at least one file; received none")
    check_one_sensor(rig)
    check_known("currents must name coils of the rig", currents_A or {}, [coil.name for coil in rig.coils])
    coils = [_coil(path, rig) for path in paths]
    maps = [_map(path) for path in paths]
    rows = torch.cat(maps)
    n = torch.tensor([len(own) for own in maps])
    on = torch.tensor(coils).repeat_interleave(n)
    each_A = torch.tensor([(currents_A or {}).get(coil.name, 1.0) for coil in rig.coils], dtype=torch.float64)
    current_A = torch.nn.functional.one_hot(on, len(rig.coils)) * each_A
    pose = torch.cat((rows[:, :3], torch.zeros(len(rows), 3, dtype=torch.float64)), dim=1)
    observations = map_observations(rig, current_A, pose, rows[:, 3:])
    names = ", ".join(path.name for path in paths)
    return Session(rig, observations, source=f"grid maps {names} ({PROVENANCE})")


def _coil(path: Path, rig: Rig) -> int:
    match = NAME.search(path.stem)
    if match is None or int(match[1]) >= len(rig.coils):
        raise InvalidInput(
            f"grid maps must be named vfield_<number>.txt, with a number below {len(rig.coils)} for the coils of rig {rig.name!r}; "
            f"received {path.name}"
        )
    return int(match[1])


def _map(path: Path) -> Float[Tensor, "point 6"]:
    header = [line.split() for line in read_lines(path)[:HEADER_LINES]]
    try:
        n = int(header[0][0])
        low, high = torch.tensor(
            [[float(cell) for cell in line] for line in header[2:]], dtype=torch.float64
        ).T
    except (IndexError, ValueError, RuntimeError) as error:
        rule = "must begin with the number of points, the points along each axis, and the range of each axis"
        raise InvalidInput(f"{path} {rule}") from error
    rows = read_numbers(path, None, HEADER_LINES)
    if rows.shape != (n, 6):
        raise InvalidInput(f"{path} must hold {n} rows of 6 numbers; it holds {len(rows)} of {rows.shape[1]}")
    slack = ROUNDING * (high - low)
    if bool(((rows[:, :3] < low - slack) | (rows[:, :3] > high + slack)).any()):
        raise InvalidInput(f"{path} must hold points within the ranges of its header; it holds others")
    return rows
