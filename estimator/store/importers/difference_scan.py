"""Imports the difference of two scans of one grid with a three-axis probe, coil on and off: public maps of mri4all/field_mapper_3DFM.

Columns are `index, dx, dy, dz, Bx, By, Bz, ...`: moves in millimetres relative to the previous row, and the field in units of 1e-7 T.
The first row is the start and the last one the return; neither is a point of the grid.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from estimator.errors import InvalidInput
from estimator.rig.rig import Rig
from estimator.store.importers.common import current_by_coil, map_observations, read_lines
from estimator.store.session import Session
from estimator.tensors import Tensor, torch

FIELD_UNIT_T = 1e-7
COLUMNS = ["index", "dx", "dy", "dz", "Bx", "By", "Bz"]


def read_difference_scan(paths: Sequence[Path], rig: Rig, currents_A: Mapping[str, float]) -> Session:
    """Read the field of the coils alone: a scan with current minus one without.

    The files hold no times, so `time_s` counts the readings.

    Args:
        paths: Two files with the same moves; the name of the one without current ends in `b0`.
        rig: Must have one pose mover, which carries the only sensor; the sensor's axes are those of the stage.
        currents_A: Current of each coil in the scan with current.
    Raises:
        InvalidInput: There are not two files, not exactly one is `b0`, or their moves differ.
    """
    off = [path for path in paths if path.stem.endswith("b0")]
    on = [path for path in paths if path not in off]
    if len(off) != 1 or len(on) != 1:
        raise InvalidInput(
            "a difference of scans takes two files, one of them named *b0; "
            f"received {', '.join(path.name for path in paths) or 'none'}"
        )
    position_m, field_on_T = _scan(on[0])
    position_off_m, field_off_T = _scan(off[0])
    if position_m.shape != position_off_m.shape or not torch.equal(position_m, position_off_m):
        raise InvalidInput(f"both scans must make the same moves; {on[0].name} and {off[0].name} do not")
    pose = torch.cat((position_m, torch.zeros_like(position_m)), dim=1)
    observations = map_observations(rig, current_by_coil(rig, currents_A), pose, field_on_T - field_off_T)
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
