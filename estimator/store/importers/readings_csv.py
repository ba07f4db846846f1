"""Reads and writes the readings CSV, the exchange format for users' scripts: one row per reading, units in the header.

Columns: `t_s, sensor, <coil>_current_A, <mover>_x_m .. _rz_rad` (or `<robot>_q0_rad .. _q5_rad`), `Bx_T, By_T, Bz_T`, and optionally
`set` (calibration or validation), `repeat`, `segment`, `recorded_at` and `<sensor or coil>_temperature_C`. Any unit of `estimator.units`
may replace the SI unit.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from pathlib import Path

from estimator.errors import Faults, InvalidInput
from estimator.readings.clock import Clock
from estimator.readings.segments import NO_SEGMENT
from estimator.rig.rig import Rig
from estimator.store.importers.csv_table import header_in, read_table
from estimator.store.importers.table_readings import FIELD, SETS, columns_of, readings_of
from estimator.store.session import Session
from estimator.store.staging import write_output


def read_readings_csv(path: Path, rig: Rig, clock: Clock = Clock.AS_WRITTEN) -> Session:
    """Read a readings CSV taken on a rig.

    Args:
        path: Comma-separated UTF-8 text. `sensor` may be left out if the rig has only one. The three rotations of a mover that only
            translates may be left out together. An empty field cell, or a word such as OVLD, is a component that was not measured.
        rig: Determines the columns.
        clock: How times are read.
    Raises:
        InvalidInput: The file does not begin with the header of a readings CSV; a cell has another type than its column; or a sensor has
            two readings at one time. The message names file, line and column.
    """
    known = columns_of(rig)
    header = header_in(path, known)
    if header is None:
        raise InvalidInput(f"{path} must begin with the header of a readings CSV of rig {rig.name!r}")
    return Session(rig, *readings_of(read_table(path, header, known, Faults()), rig, clock).readings)


def is_readings_csv(path: Path, rig: Rig) -> bool:
    """Whether the first line of a file is the header of a readings CSV of the rig."""
    return header_in(path, columns_of(rig)) is not None


def write_readings_csv(session: Session, path: Path, overwrite: bool = True) -> None:
    """Write a session's readings in SI with all digits, so that reading the file gives exactly the same numbers.

    Raises:
        InvalidInput: The file cannot be written, or is there and `overwrite` is not set.
    """
    rig, o = session.rig, session.observations
    names = [sensor.name for sensor in rig.sensors]
    columns: dict[str, Sequence[object]] = {
        "t_s": o.time_s.tolist(),
        "sensor": [names[i] for i in o.sensor.tolist()],
    }
    columns |= {f"{coil.name}_current_A": o.current_A[:, i].tolist() for i, coil in enumerate(rig.coils)}
    for mover in rig.movers:
        columns |= {name: o.motion[mover.name][:, i].tolist() for i, name in enumerate(mover.columns)}
    for i, name in enumerate(FIELD):
        columns[f"{name}_T"] = ["" if math.isnan(b) else b for b in o.field_sensor_T[:, i].tolist()]
    if o.is_validation.any():
        columns["set"] = [SETS[i] for i in o.is_validation.tolist()]
    if o.repeat.any():
        columns["repeat"] = o.repeat.tolist()
    if o.recorded_segment is not None:
        columns["segment"] = ["" if i == NO_SEGMENT else i for i in o.recorded_segment.tolist()]
    columns |= {f"{name}_temperature_C": values.tolist() for name, values in o.temperature_C.items()}
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*columns.values(), strict=True))
    write_output(path, text.getvalue(), overwrite)
