"""Imports scans along a coil's axis: two or three columns of position, field and an error or scale reading (not used).

Made for the student-laboratory scans of Goettingen (miallo/13MagSpu) and Dortmund (4iphaton/V308SpulenMagnetfelder).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from estimator.errors import InvalidInput, quoted
from estimator.rig.rig import Rig
from estimator.store.importers.common import check_one_sensor, current_by_coil, map_observations, read_numbers
from estimator.store.session import Session
from estimator.tensors import torch
from estimator.units import UNITS


def read_axis_scan(
    path: Path, rig: Rig, currents_A: Mapping[str, float], *, position_unit: str = "cm", field_unit: str = "G"
) -> Session:
    """Read one scan; positions become z of the stage, the field becomes the sensor's z component.

    The file holds no times, so `time_s` counts the readings. A third column and the zero of the scale are not used: noise and offset are
    parameters of the rig.

    Args:
        path: Numbers separated by blanks; lines that start with # are skipped.
        rig: Must have one pose mover, which carries the only sensor along z.
        currents_A: Current of each coil.
        position_unit, field_unit: Symbols of `estimator.units`.
    Raises:
        InvalidInput: The file is not a table of two or three columns, a unit is unknown, or a coil has no current.
    """
    check_one_sensor(rig)
    to_m, to_T = _to_si(position_unit, "length"), _to_si(field_unit, "field")
    table = read_numbers(path)
    if table.shape[1] not in (2, 3):
        raise InvalidInput(f"{path} must have two or three columns; it has {table.shape[1]}")
    pose = torch.zeros(len(table), 6, dtype=torch.float64)
    pose[:, 2] = table[:, 0] * to_m
    field_T = torch.full((len(table), 3), torch.nan, dtype=torch.float64)
    field_T[:, 2] = table[:, 1] * to_T
    observations = map_observations(rig, current_by_coil(rig, currents_A), pose, field_T)
    return Session(rig, observations, f"axis scan {path.name}; t_s counts the readings")


def _to_si(symbol: str, dimension: str) -> float:
    unit = UNITS.get(symbol)
    if unit is None or unit.dimension != dimension:
        known = ", ".join(u.symbol for u in UNITS.values() if u.dimension == dimension)
        raise InvalidInput(f"unit of {dimension} must be one of {known}; received {quoted(symbol)}")
    return unit.to_si
