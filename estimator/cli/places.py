"""Places and currents among which stops are chosen: those of a plan file, or those that the limits of the instruments allow."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from drivers.errors import Refused
from drivers.limits_section import RigLimits
from drivers.protocols import FlangePose
from drivers.safety import check_motion
from estimator.errors import InvalidInput
from estimator.frames import Transform
from estimator.geometry.motion import flange_to_reach
from estimator.planning.candidates import places_within
from estimator.readings.plan import Plan, load_plan
from estimator.rig.bodies import MotionKind
from estimator.rig.rig import Rig
from estimator.tensors import torch


def places_of(rig: Rig, path: Path | None, limits: RigLimits, is_any_order: bool = False) -> Plan:
    """Places and currents within the limits.

    Args:
        rig: Names coils and movers.
        path: A plan file; without it, displacements fill the workspace of each arm, which stands in its middle at zero displacement, and
            currents are those that a coil bears for ever.
        limits: Of the instruments; empty where they are not known.
        is_any_order: Whether stops may follow each other in any order and number, so that only currents are left that a coil bears for
            ever.
    Raises:
        InvalidInput: No file is given and the limits do not say where to measure, or no place or current is within them.
    """
    if path is None:
        missing = [c.name for c in rig.coils if c.name not in limits.currents]
        if missing:
            raise InvalidInput(
                f"places and currents must come from a plan file, or from the limits of the instruments; {missing[0]} has no limits: "
                "give PLAN after RIG, or --devices"
            )
        spans_m = {
            name: 0.5 * np.array([-1.0, 1.0])[:, None] * np.subtract(arm.highest_m, arm.lowest_m)
            for name, arm in limits.arms.items()
        }
        largest_A = {n: min(limit.highest_A, limit.continuous_A) for n, limit in limits.currents.items()}
        places = places_within(rig, spans_m, largest_A)
    else:
        places = load_plan(path, rig)
    within = replace(
        places,
        calibration=tuple(pose for pose in places.calibration if _is_reached(pose, rig, limits)),
        validation=tuple(pose for pose in places.validation if _is_reached(pose, rig, limits)),
        currents_A=tuple(
            setting for setting in places.currents_A if _is_allowed(setting, limits, is_any_order)
        ),
        stops=tuple(
            s
            for s in places.stops
            if _is_reached(s.pose, rig, limits) and _is_allowed(s.current_A, limits, is_any_order)
        ),
        repeats=1,
        n_revisited=0,
    )
    if not within.stops and not (within.calibration and within.currents_A):
        raise InvalidInput(
            f"places and currents must be within the limits of the instruments; none of plan {places.name!r} is"
        )
    return within


def _is_allowed(setting: Mapping[str, float], limits: RigLimits, is_for_ever: bool) -> bool:
    return all(
        limits.currents[name].lowest_A <= current_A <= limits.currents[name].highest_A
        and not (is_for_ever and abs(current_A) > limits.currents[name].continuous_A)
        for name, current_A in setting.items()
        if name in limits.currents
    )


def _is_reached(pose: Mapping[str, np.ndarray], rig: Rig, limits: RigLimits) -> bool:
    """Whether all arms may stand at a pose; displacements count from a place that is not known yet."""
    for mover in rig.movers:
        if mover.motion is MotionKind.DISPLACEMENT or mover.name not in limits.arms:
            continue
        flange = flange_to_reach(mover, torch.from_numpy(pose[mover.name])[None], Transform.identity())
        target, arm = FlangePose(*flange.to_pose()), limits.arms[mover.name]
        try:
            check_motion(target, target, arm.highest_speed_m_per_s, arm)
        except Refused:
            return False
    return True
