"""Two scans of one grid with a three-axis probe, coil on and coil off, as their difference: the public maps of mri4all/field_mapper_3DFM.

Columns are `index, dx, dy, dz, Bx, By, Bz, ...`: moves in millimetres, each relative to the row before, and the field in units of 1e-7 T.
The first row is the start and the last one the way back; neither is a point of the grid.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import torch
from torch import Tensor

from estimator.errors import InvalidInput
from estimator.rig.rig import Rig
from estimator.store.importers.common import current_by_coil, map_observations, read_lines
from estimator.store.session import Session

FIELD_UNIT_T = 1e-7
COLUMNS = ["index", "dx", "dy", "dz", "Bx", "By", "Bz"]


def read_difference_scan(paths: Sequence[Path], rig: Rig, currents_A: Mapping[str, float]) -> Session:
    """Read what a coil adds to the field of everything else: a scan with its current less one without.

    The files hold no times: `time_s` counts the readings.

    Args:
        paths: Two files of the same moves; the one whose name ends in `b0` was taken without current.
        rig: One pose mover that carries the one sensor, whose axes are those of the stage.
        currents_A: Per coil, in the scan with current.
    Raises:
        InvalidInput: Not two files, none or both of them `b0`, or other moves in one than in the other.
    """
    off = [path for path in paths if path.stem.endswith("b0")]
    on = [path for path in paths if path not in off]
    if len(off) != 1 or len(on) != 1:
        raise InvalidInput(
            "a difference of scans takes two files, one of them named *b0; "
            f"received {', '.join(path.name for path in paths) or 'none'}"
        )
    position_m, with_current_T = _scan(on[0])
    position_off_m, without_T = _scan(off[0])
    if position_m.shape != position_off_m.shape or not torch.equal(position_m, position_off_m):
        raise InvalidInput(f"both scans must make the same moves; {on[0].name} and {off[0].name} do not")
    n = len(position_m)
    observations = map_observations(
        rig,
        torch.arange(n, dtype=torch.float64),
        torch.zeros(n, dtype=torch.int64),
        current_by_coil(rig, currents_A),
        torch.cat((position_m, torch.zeros(n, 3, dtype=torch.float64)), dim=1),
        with_current_T - without_T,
    )
    return Session(rig, observations, f"{on[0].name} less {off[0].name}; t_s counts the readings")


def _scan(path: Path) -> tuple[Tensor, Tensor]:
    lines = [line.rstrip(",").split(",") for line in read_lines(path) if line.strip()]
    if not lines or lines[0][: len(COLUMNS)] != COLUMNS or len(lines) < 4:
        raise InvalidInput(f"{path} must begin with {','.join(COLUMNS)} and hold at least three rows")
    try:
        table = torch.tensor([[float(cell) for cell in row[1:7]] for row in lines[1:]], dtype=torch.float64)
    except ValueError as error:
        raise InvalidInput(f"cells must be numbers: {error} ({path})") from error
    if not bool(torch.isfinite(table).all()):
        raise InvalidInput(f"cells must be finite numbers ({path})")
    position_m = torch.cumsum(table[:, :3], dim=0) * 1e-3
    return position_m[1:-1], table[1:-1, 3:] * FIELD_UNIT_T
