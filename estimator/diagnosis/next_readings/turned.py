"""Sensors that are turned by hand before the next readings, where they stand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from estimator.frames import Transform
from estimator.geometry.motion import base_from_motion, motion_reached
from estimator.readings.observations import Observations
from estimator.rig.bodies import MotionKind, Mover
from estimator.rig.rig import Rig

ROTATION = ("rx_rad", "ry_rad", "rz_rad")


def orientation(rig: Rig, sensor: str) -> str | None:
    """Prefix of the rotation by which a sensor can be turned; None where the rotation is free or absent."""
    for block in ("world_from_sensor", "flange_from_sensor"):
        names = [f"{sensor}.{block}.{key}" for key in ROTATION]
        if all(name in rig.parameters and not rig.parameters[name].is_free for name in names):
            return f"{sensor}.{block}"
    return None


def turned(
    readings: Observations, rig: Rig, turns_rad: Mapping[str, tuple[float, float, float]]
) -> tuple[Observations, Rig]:
    """Readings and rig with sensors turned where they stand.

    The mount of a body that a displacement carries also says along which axes it moves. There the carrier turns instead, about the sensor.

    Args:
        readings: Poses and currents.
        rig: Names the sensors.
        turns_rad: Rotation vectors in the present frames of the sensors, by name.
    """
    for i, sensor in enumerate(rig.sensors):
        if sensor.name not in turns_rad:
            continue
        turn = Rotation.from_rotvec(turns_rad[sensor.name])
        prefix = orientation(rig, sensor.name)
        nominal = {key: rig.parameters[f"{prefix}.{key}"].value for key in ROTATION}
        rotation = Rotation.from_rotvec(list(nominal.values()))
        mover = None if sensor.carried_by is None else rig.mover(sensor.carried_by)
        if mover is not None and mover.motion is MotionKind.DISPLACEMENT:
            place_m = [rig.parameters[f"{prefix}.{axis}_m"].value for axis in "xyz"]
            about_sensor = (rotation * turn * rotation.inv()).as_rotvec().tolist()
            readings = _turned_by(mover, readings, readings.sensor == i, about_sensor, place_m)
        else:
            new_rad = (rotation * turn).as_rotvec()
            rig = rig.with_values({f"{prefix}.{key}": new_rad[j] for j, key in enumerate(ROTATION)})
    return readings, rig


def _turned_by(
    mover: Mover, readings: Observations, rows: Tensor, turn_rad: Sequence[float], about_m: Sequence[float]
) -> Observations:
    """Readings with the flange of a displacement turned at some rows, about a point of its frame that stays in place."""
    motion = readings.motion[mover.name]
    about, vector_rad = motion.new_tensor(about_m), motion.new_tensor(turn_rad)
    turn = Transform.from_pose(torch.zeros_like(about), vector_rad)
    turn = Transform(turn.rotation, about - turn.rotation @ about)
    reached = motion_reached(
        mover, base_from_motion(mover, motion) @ turn, Transform.identity(motion.dtype, motion.device), motion
    )
    return replace(
        readings,
        motion={**readings.motion, mover.name: torch.where(rows[:, None], reached, motion)},
    )
