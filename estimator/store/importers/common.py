"""What importers share: lines and numbers of a text file, the one pose mover of a map, currents by coil."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import torch
from jaxtyping import Float, Int
from torch import Tensor

from estimator.errors import InvalidInput, reason
from estimator.readings.observations import Observations
from estimator.rig.rig import MotionKind, Mover, Rig


def finite_number(cell: str, name: str, place: str) -> float:
    """One cell as a finite number.

    Args:
        cell: The text.
        name: What the number is, for the message.
        place: Where it stands, for the message.
    Raises:
        InvalidInput: Empty, no number, NaN or infinite.
    Examples:
        >>> finite_number(" 1.5e-3", "t_s", "readings.csv, line 2")
        0.0015
    """
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or "_" in cell:  # Python reads 1_000 as a thousand; no instrument writes that
        raise InvalidInput(f"{name} must be a finite number; received {cell.strip()!r} ({place})")
    return value


def read_lines(path: Path) -> list[str]:
    """The lines of a text file; a byte order mark and Windows line ends are taken off.

    Raises:
        InvalidInput: The file cannot be read, or is not UTF-8.
    """
    try:
        return path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidInput(f"{path} must be readable as text: {reason(error)}") from error


def read_numbers(
    path: Path, separator: str | None = None, header_lines: int = 0
) -> Float[Tensor, "row column"]:
    """A table of numbers; lines that are blank or start with # are skipped.

    Args:
        path: The file.
        separator: Between cells; None for any run of blanks.
        header_lines: Lines at the top that hold no numbers.
    Raises:
        InvalidInput: A cell is not a finite number, rows are of different length, or there is no row.
    """
    rows: list[list[float]] = []
    for line, text in enumerate(read_lines(path)[header_lines:], start=1 + header_lines):
        if not text.strip() or text.lstrip().startswith("#"):
            continue
        cells = text.split(separator)
        if rows and len(cells) != len(rows[0]):
            raise InvalidInput(
                f"rows must have {len(rows[0])} cells; received {len(cells)} ({path}, line {line})"
            )
        rows.append(
            [finite_number(cell, f"cell {i}", f"{path}, line {line}") for i, cell in enumerate(cells, 1)]
        )
    if not rows:
        raise InvalidInput(f"{path} must hold at least one row of numbers; it holds none")
    return torch.tensor(rows, dtype=torch.float64)


def pose_mover(rig: Rig) -> Mover:
    """The one mover of a map, which carries every sensor and reports poses.

    Raises:
        InvalidInput: The rig is of another kind.
    """
    movers = [mover for mover in rig.movers if mover.motion is MotionKind.POSE]
    if len(rig.movers) != 1 or len(movers) != 1 or any(s.carried_by != movers[0].name for s in rig.sensors):
        raise InvalidInput(
            f"rig {rig.name!r} must have one mover, of motion pose, that carries every sensor; it does not"
        )
    return movers[0]


def current_by_coil(rig: Rig, currents_A: Mapping[str, float]) -> list[float]:
    """Currents in the order of the rig's coils.

    Raises:
        InvalidInput: A coil has no current, or a name is not a coil.
    """
    names = [coil.name for coil in rig.coils]
    if sorted(names) != sorted(currents_A):
        raise InvalidInput(
            f"currents must be given for each coil of rig {rig.name!r} ({', '.join(names)}); "
            f"received {', '.join(currents_A) or 'none'}"
        )
    return [finite_number(str(currents_A[name]), f"current of {name}", f"rig {rig.name!r}") for name in names]


def map_observations(
    rig: Rig,
    time_s: Float[Tensor, " reading"],
    sensor: Int[Tensor, " reading"],
    current_A: Sequence[float] | Float[Tensor, "reading coil"],
    pose: Float[Tensor, "reading 6"],
    field_sensor_T: Float[Tensor, "reading 3"],
    repeat: Int[Tensor, " reading"] | None = None,
) -> Observations:
    """Readings of a map taken with one pose mover, none of them kept out of the fit.

    Args:
        rig: Its mover names the motion.
        time_s, sensor, pose, field_sensor_T, repeat: As in `Observations`; without `repeat` there are none.
        current_A: Per reading and coil, or per coil where it was the same throughout.
    """
    n = len(time_s)
    current = torch.as_tensor(current_A, dtype=torch.float64).expand(n, len(rig.coils)).clone()
    none = torch.zeros(n, dtype=torch.int64)
    motion = {pose_mover(rig).name: pose}
    return Observations(
        time_s, sensor, current, motion, field_sensor_T, none.bool(), none if repeat is None else repeat, {}
    )
