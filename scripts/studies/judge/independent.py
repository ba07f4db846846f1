"""Readings of hidden sessions predicted from the numbers that were handed out, by code that shares nothing with coilcal's fields.

Only `summary.json`, `readings.csv` and the kind of mover in `rig.yaml` are read. Poses are those of the generator in NumPy and SciPy,
every loop is one of magpylib (`tests/hidden`). It covers round air-cored coils that nothing acts on but a constant field of the room
and constant zeros.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from tests.hidden.coil import Winding, blocks_of, circular_field
from tests.hidden.ur_arm import ALONG_X_M, flange_pose

ALL_LOOPS = 10_000  # nodes; no direction of a winding has as many
ACTING = ("background_field[room].", "sensor_offset[")
RIG = "rig.yaml"
Numbers = Mapping[str, float]
Row = Mapping[str, str]


def missed_T(folder: Path, best: Numbers, measured_T: np.ndarray, is_asked: np.ndarray) -> float | None:
    """Root mean square length of the error vectors of some readings; None where `predicted_T` is none or a component is missing."""
    if not (folder / RIG).exists() or not is_asked.any() or not np.isfinite(measured_T[is_asked]).all():
        return None
    with (folder / "readings.csv").open(encoding="utf-8", newline="") as file:
        rows = [row for row, is_own in zip(csv.DictReader(file), is_asked, strict=True) if is_own]
    motion = yaml.safe_load((folder / RIG).read_text(encoding="utf-8"))["movers"]["arm1"]["motion"]
    field_T = predicted_T(best, rows, motion)
    return None if field_T is None else float(np.sqrt(3.0 * np.square(measured_T[is_asked] - field_T).mean()))


def predicted_T(best: Numbers, rows: list[Row], motion: str) -> np.ndarray | None:
    """Components at each reading's sensor, in its axes; None where something acts that this code does not have.

    Args:
        best: Every number of the rig by name, as in `summary.json`.
        rows: Of the table of readings as the generator writes it, in SI units.
        motion: What the arm writes down: `displacement`, `pose`, or the name of a UR.
    """
    others = [key for key in rows[0] if key.endswith("_current_A") and key != "coil1_current_A"]
    is_known = all("[" not in name or name.startswith(ACTING) for name in best)
    if not is_known or any(float(row[key]) != 0.0 for row in rows for key in others):
        return None
    sensors = [row["sensor"] for row in rows]
    rotation, origin_m = _world_from_coil(best, rows, motion)
    poses = {name: _pose(best, f"{name}.world_from_sensor") for name in set(sensors)}
    points_m = np.array([poses[name][1] for name in sensors])
    current_A = best["coil1.current_gain"] * _columns(rows, "coil1_current_A")
    winding = replace(
        Winding(best["coil1.radius_m"], best["coil1.wire_radius_m"], *_counts(best)),
        axial_pitch_factor=0.5 * best["coil1.axial_pitch_m"] / best["coil1.wire_radius_m"],
        radial_pitch_factor=0.5 * best["coil1.radial_pitch_m"] / best["coil1.wire_radius_m"],
    )
    per_A = circular_field(blocks_of(winding), ALL_LOOPS)(rotation.inv().apply(points_m - origin_m))
    world_T = current_A * rotation.apply(per_A) + _vector(best, "background_field[room]")
    shown_T = [poses[name][0].inv().apply(field) for name, field in zip(sensors, world_T, strict=True)]
    gains = np.array([[best.get(f"{name}.gain", 1.0)] for name in sensors])
    return gains * shown_T + [_vector(best, f"sensor_offset[{name}]") for name in sensors]


def _world_from_coil(best: Numbers, rows: list[Row], motion: str) -> tuple[Rotation, np.ndarray]:
    """Rotation and origin of coil1 in every reading."""
    if motion in ALONG_X_M:
        matrices, place_m = flange_pose(motion, _columns(rows, *(f"arm1_q{k}_rad" for k in range(6))))
        turn = Rotation.from_matrix(matrices)
    else:
        place_m = _columns(rows, *(f"arm1_{axis}_m" for axis in "xyz"))
        turn = Rotation.from_rotvec(_columns(rows, *(f"arm1_r{axis}_rad" for axis in "xyz"), default=0.0))
    if motion == "displacement":
        first, at_m = _pose(best, "coil1.world_from_coil0")
        return first * turn, at_m + first.apply(place_m)
    base, base_m = _pose(best, "arm1.world_from_base")
    mount, mount_m = _pose(best, "coil1.flange_from_coil")
    return base * turn * mount, base_m + base.apply(place_m + turn.apply(mount_m))


def _pose(best: Numbers, block: str) -> tuple[Rotation, np.ndarray]:
    """A rotation, which a small one about its own axes follows, and a place."""
    turn, tilt = (
        Rotation.from_rotvec([best.get(f"{block}.{key}", 0.0) for key in keys])
        for keys in (("rx_rad", "ry_rad", "rz_rad"), ("tilt_x_rad", "tilt_y_rad", "spin_rad"))
    )
    return turn * tilt, np.array([best.get(f"{block}.{axis}_m", 0.0) for axis in "xyz"])


def _counts(best: Numbers) -> tuple[int, int]:
    return round(best["coil1.axial_loops"]), round(best["coil1.radial_loops"])


def _vector(best: Numbers, cause: str) -> np.ndarray:
    return np.array([best.get(f"{cause}.{axis}_T", 0.0) for axis in "xyz"])


def _columns(rows: list[Row], *names: str, default: float | None = None) -> np.ndarray:
    """Columns of the table; a default where it lacks one."""
    return np.array(
        [[float(row[n]) if default is None else float(row.get(n, default)) for n in names] for row in rows]
    )
