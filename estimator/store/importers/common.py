"""Helpers of the importers: lines and numbers of a text file, the pose mover of a map, currents by coil."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

from jaxtyping import Float, Int

from estimator.errors import InvalidInput, Place, quoted
from estimator.given_files import MOST_TABLE_BYTES, read_given_text
from estimator.readings.observations import Observations
from estimator.rig.bodies import MotionKind, Mover
from estimator.rig.rig import Rig
from estimator.store.importers.table import number_of
from estimator.tensors import Tensor, torch


def finite_number(cell: str, name: str, location: str) -> float:
    """Convert a cell to a finite number.

    Args:
        cell: Text of the cell.
        name: Name of the quantity, for messages.
        location: File and line, for messages.
    Raises:
        InvalidInput: The cell is empty, not a number, NaN or infinite.
    Examples:
        >>> finite_number(" 1.5e-3", "t_s", "readings.csv, line 2")
        0.0015
    """
    value = number_of(cell)
    if math.isnan(value):
        raise InvalidInput(f"{name} must be a finite number; received {quoted(cell.strip())} ({location})")
    return value


def read_lines(path: Path) -> list[str]:
    """The lines of a text file, without byte order mark and line ends (Unix or Windows).

    Raises:
        InvalidInput: The file cannot be read, or is not UTF-8.
    """
    text = read_given_text(path, MOST_TABLE_BYTES)
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    return lines if lines[-1] else lines[:-1]


def read_numbers(
    path: Path, separator: str | None = None, header_lines: int = 0
) -> Float[Tensor, "row column"]:
    """A table of numbers; lines that are blank or start with # are skipped.

    Args:
        path: The file.
        separator: Separator of cells; None for any run of blanks.
        header_lines: Number of lines to skip at the top.
    Raises:
        InvalidInput: A cell is not a finite number, rows differ in length, or there is no row.
    """
    rows: list[list[float]] = []
    for line, text in enumerate(read_lines(path)[header_lines:], start=1 + header_lines):
        if not text.strip() or text.lstrip().startswith("#"):
            continue
        cells = text.split(separator)
        if rows and len(cells) != len(rows[0]):
            words = f"rows must have {len(rows[0])} cells; received {len(cells)}"
            raise InvalidInput.at(Place(str(path), line), words)
        rows.append(
            [finite_number(cell, f"cell {i}", f"{path}, line {line}") for i, cell in enumerate(cells, 1)]
        )
    if not rows:
        raise InvalidInput(f"{path} must hold at least one row of numbers; it holds none")
    return torch.tensor(rows, dtype=torch.float64)


def pose_mover(rig: Rig) -> Mover:
    """The mover of a map, which carries every sensor and reports poses.

    Raises:
        InvalidInput: The rig has other movers, or a sensor that this one does not carry.
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
    current_A: Sequence[float] | Float[Tensor, "reading coil"],
    pose: Float[Tensor, "reading 6"],
    field_sensor_T: Float[Tensor, "reading 3"],
    *,
    time_s: Float[Tensor, " reading"] | None = None,
    sensor: Int[Tensor, " reading"] | None = None,
    repeat: Int[Tensor, " reading"] | None = None,
) -> Observations:
    """Observations of a map taken with one pose mover; all readings take part in the fit.

    Args:
        rig: Must have one pose mover.
        current_A: Current by reading and coil, or by coil if constant.
        pose, field_sensor_T: As in `Observations`.
        time_s, sensor, repeat: As in `Observations`; by default the time counts the readings, and the others are zero.
    """
    currents_A = torch.as_tensor(current_A, dtype=torch.float64).expand(len(pose), len(rig.coils)).clone()
    given = {"time_s": time_s, "sensor": sensor, "repeat": repeat}
    more = {name: values for name, values in given.items() if values is not None}
    return Observations.of(currents_A, {pose_mover(rig).name: pose}, field_sensor_T, **more)


def check_one_sensor(rig: Rig) -> None:
    """Refuse a rig with another number of sensors than one.

    Raises:
        InvalidInput: It has.
    """
    if len(rig.sensors) != 1:
        raise InvalidInput(f"rig {rig.name!r} must have one sensor; it has {len(rig.sensors)}")


CLOCKS_APART = timedelta(days=1)  # a date later than that from now is a typing error


def moment(text: str, name: str) -> str:
    """An ISO 8601 date and time in UTC, to the second.

    Args:
        text: A date, or a date and a time; without a zone it is local time.
        name: Name of the quantity, for messages.
    Raises:
        InvalidInput: It is no date, or lies in the future.
    Examples:
        >>> moment("2026-03-01T09:30:00+01:00", "--recorded-at")
        '2026-03-01T08:30:00+00:00'
    """
    try:
        time = datetime.fromisoformat(text.strip()).astimezone(UTC)
    except (ValueError, OverflowError):
        rule = f"{name} must be a date such as 2026-03-01 or 2026-03-01T09:30+01:00"
        raise InvalidInput(f"{rule}; received {quoted(text.strip())}") from None
    if time > datetime.now(UTC) + CLOCKS_APART:
        raise InvalidInput(f"{name} must not lie in the future; received {quoted(text.strip())}")
    return time.isoformat(timespec="seconds")
