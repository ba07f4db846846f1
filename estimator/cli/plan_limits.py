"""Checks a whole plan against the limits of a rig before anything moves, so that no refusal comes after an hour."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from drivers.errors import Refused
from drivers.limits_section import RigLimits
from drivers.protocols import FlangePose
from drivers.safety import CoilLoad, check_current, check_motion
from estimator.acquisition.pace import Pace
from estimator.frames import Transform, vector_from_rotation
from estimator.geometry.motion import flange_to_reach
from estimator.readings.observations import Observations
from estimator.rig.bodies import MotionKind
from estimator.rig.rig import Rig
from estimator.store.growing import load_so_far


def loads_so_far(
    records: Sequence[Mapping[str, Any]], rig: Rig, limits: RigLimits, now_s: float
) -> dict[str, CoilLoad]:
    """Thermal load that the stops of a session so far have left in each coil.

    Args:
        records: Stops of the session's journal.
        rig: Names the coils.
        limits: Limits of its devices.
        now_s: Time since the session began.
    """
    loads = {}
    for name, spells in load_so_far(records, [coil.name for coil in rig.coils], now_s).items():
        if name in limits.currents:
            load = CoilLoad(0.0, 0.0)
            for duration_s, current_A in spells:
                load = load.after(current_A, load.time_s + duration_s, limits.currents[name])
            loads[name] = load
    return loads


def check_currents(
    stops: Observations,
    rig: Rig,
    limits: RigLimits,
    times_s: Sequence[float],
    n_before: int = 0,
    loads: Mapping[str, CoilLoad] | None = None,
) -> None:
    """Refuse a plan that asks a coil for too much current, or for too much for too long.

    Args:
        stops: Stops of the whole plan.
        rig: Names the coils.
        limits: Limits of its devices.
        times_s: Duration of each stop.
        n_before: Stops that earlier runs have visited; they are not counted again.
        loads: Thermal load that they left in the coils (`loads_so_far`); cold coils by default.
    Raises:
        Refused: A coil would be overloaded; the message names the stop.
    """
    for i, coil in enumerate(rig.coils):
        if coil.name not in limits.currents:
            continue
        limit, load = limits.currents[coil.name], (loads or {}).get(coil.name, CoilLoad(0.0, 0.0))
        for row in range(n_before, len(times_s)):
            time_s = times_s[row]
            current_A = float(stops.current_A[row, i])
            try:
                check_current(current_A, time_s, load, limit)
            except Refused as error:
                raise Refused(f"stop {row + 1} of the plan, {coil.name}: {error}") from error
            load = load.after(current_A, load.time_s + time_s, limit)


def check_ways(
    stops: Observations, rig: Rig, limits: RigLimits, pace: Pace, references: Mapping[str, Transform]
) -> None:
    """Refuse a plan that leads an arm out of its workspace, or moves it too fast.

    Args:
        stops: Stops to visit.
        rig: Names the movers.
        limits: Limits of its devices.
        pace: Speeds of the arms.
        references: base_from_flange at zero displacement, by mover. Without it the way to the first stop is not checked, and a mover that
            counts displacements is not checked at all: where it goes is not known before its arm is asked.
    Raises:
        Refused: A way is not allowed; the message names the stop.
    """
    for mover in rig.movers:
        reference = references.get(mover.name)
        if reference is None and mover.motion is MotionKind.DISPLACEMENT:
            continue
        targets = flange_to_reach(mover, stops.motion[mover.name], reference or Transform.identity())
        start = _pose(targets if reference is None else reference, 0)
        for row in range(len(stops)):
            target = _pose(targets, row)
            try:
                check_motion(start, target, pace.speed_m_per_s[mover.name], limits.arms[mover.name])
            except Refused as error:
                raise Refused(
                    f"stop {row + 1} of the plan, {mover.name}: {error} (its section in devices, in the frame of its base)"
                ) from error
            start = target


def _pose(poses: Transform, row: int) -> FlangePose:
    rotation = poses.rotation[min(row, len(poses.rotation) - 1)]
    x_m, y_m, z_m = poses.translation_m[row].tolist()
    x_rad, y_rad, z_rad = vector_from_rotation(rotation).tolist()
    return FlangePose((x_m, y_m, z_m), (x_rad, y_rad, z_rad))
