"""A whole plan against the limits of a rig, before anything moves: nobody wants a refusal after an hour."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from drivers.errors import Refused
from drivers.limits_section import RigLimits
from drivers.protocols import FlangePose
from drivers.safety import CoilLoad, check_current, check_motion
from estimator.frames import Transform, vector_from_rotation
from estimator.motion import flange_to_reach
from estimator.pace import Pace
from estimator.records import Observations
from estimator.rig import Rig


def check_currents(stops: Observations, rig: Rig, limits: RigLimits, times_s: Sequence[float]) -> None:
    """Refuse a plan that asks a coil for too much, at once or for too long.

    Args:
        stops: To be visited by a rig that is cold at the start.
        rig: Names the coils.
        limits: Of its devices.
        times_s: That each stop takes.
    Raises:
        Refused: It does; the message names the stop.
    """
    for i, coil in enumerate(rig.coils):
        if coil.name not in limits.currents:
            continue
        limit, load = limits.currents[coil.name], CoilLoad(0.0, 0.0)
        for row, time_s in enumerate(times_s):
            current_A = float(stops.current_A[row, i])
            try:
                check_current(current_A, time_s, load, limit)
            except Refused as error:
                raise Refused(f"stop {row + 1} of the plan, {coil.name}: {error}") from error
            load = load.after(current_A, load.time_s + time_s, limit)


def check_ways(
    stops: Observations, rig: Rig, limits: RigLimits, pace: Pace, references: Mapping[str, Transform]
) -> None:
    """Refuse a plan that leads an arm out of its workspace, or too fast.

    Args:
        stops: To be visited.
        rig: Names the movers.
        limits: Of its devices.
        pace: Speeds of the arms.
        references: base_from_flange where displacements are zero, by mover.
    Raises:
        Refused: It does; the message names the stop.
    """
    for mover in rig.movers:
        there = flange_to_reach(mover, stops.motion[mover.name], references[mover.name])
        start = _pose(references[mover.name], 0)
        for row in range(len(stops)):
            target = _pose(there, row)
            try:
                check_motion(start, target, pace.speed_m_per_s[mover.name], limits.arms[mover.name])
            except Refused as error:
                raise Refused(f"stop {row + 1} of the plan, {mover.name}: {error}") from error
            start = target


def _pose(poses: Transform, row: int) -> FlangePose:
    rotation = poses.rotation[min(row, len(poses.rotation) - 1)]
    x_m, y_m, z_m = poses.translation_m[row].tolist()
    x_rad, y_rad, z_rad = vector_from_rotation(rotation).tolist()
    return FlangePose((x_m, y_m, z_m), (x_rad, y_rad, z_rad))
