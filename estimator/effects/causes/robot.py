"""How the real pose of a mover differs from what it reports."""

from __future__ import annotations

import math
from collections.abc import Mapping

from estimator.effects.base import Theta, normal, triple, vector
from estimator.effects.causes.misplaced import elsewhere, of_numbers
from estimator.effects.circumstances import Circumstances
from estimator.effects.during import during, spell
from estimator.effects.segments import each_segment, is_several, of_segment
from estimator.effects.stages import Columns, MotionEffect
from estimator.frames import Transform, rotation_from_vector
from estimator.geometry.kinematics import base_from_joints
from estimator.geometry.motion import base_from_motion, ends_of
from estimator.rig.arms import N_JOINTS
from estimator.rig.bodies import MotionKind
from estimator.rig.rig import Rig
from estimator.tensors import Tensor, torch

LEAST_TURN = 1e-6  # of a rotation matrix: below, a mover only moves
# The joint that gives way, and that at which the weight sits; None is the flange.
SAGGING: dict[str, tuple[int, int | None]] = {
    "shoulder_by_elbow_rad_per_m": (1, 2),
    "shoulder_rad_per_m": (1, None),
    "elbow_rad_per_m": (2, None),
}
BEFORE = "where the mover came from"
SHIFT, TURN = ("x_m", "y_m", "z_m"), ("rx_rad", "ry_rad", "rz_rad")


def _shifted(pose: Transform, shift_m: Tensor) -> Transform:
    return Transform(pose.rotation, pose.translation_m + shift_m)


@MotionEffect.cause(quantities=triple("xyz", "", "1", 0.005))
def robot_scale(pose: Transform, theta: Theta) -> Transform:
    """The robot's axes have a wrong scale.

    The robot moves a fixed multiple of what it says, axis by axis.

    Source: uncalibrated arms err by 1 mm in 0.5 m; worn screws by per mille.
    """
    return _shifted(pose, vector(theta, "xyz") * pose.translation_m)


# Quantities: how far x leans along y, x along z, and y along z.
@MotionEffect.cause(quantities=triple(("xy", "xz", "yz"), "", "1", 0.005))
def robot_shear(pose: Transform, theta: Theta) -> Transform:
    """The robot's axes are not at right angles.

    Source: portal axes are squared to 1 mrad and better; arms err as in robot_scale.
    """
    _, y, z = pose.translation_m.unbind(-1)
    xy, xz, yz = (theta[key][..., None] for key in ("xy", "xz", "yz"))
    shift = torch.broadcast_tensors(xy * y + xz * z, yz * z, torch.zeros_like(z))
    return _shifted(pose, torch.stack(shift, dim=-1))


def _direction_of_last_move(circumstances: Circumstances, mover: str) -> Columns:
    return torch.nn.functional.normalize(circumstances.last_move_m(mover), dim=-1, eps=1e-12)


@MotionEffect.cause(
    quantities=(normal("lag_m", "m", 200e-6),), columns=_direction_of_last_move, depends_on=BEFORE
)
def position_lag(pose: Transform, columns: Columns, theta: Theta) -> Transform:
    """The mover stops short along its last move.

    The mover stops short of its target by a fixed length, along its last move.

    Source: in-position windows of controllers, 10 to 100 um.
    """
    return _shifted(pose, -theta["lag_m"][..., None, None] * columns)


@MotionEffect.cause(
    quantities=triple("xyz", "_m", "m", 200e-6),
    columns=lambda circumstances, mover: circumstances.approach(mover),
    depends_on=BEFORE,
)
def backlash(pose: Transform, columns: Columns, theta: Theta) -> Transform:
    """The axes have play: the position depends on the side it was reached from.

    Each axis stands half its play short of its target, on the side it came from.

    Source: spindles and gears, 10 to 200 um.
    """
    return _shifted(pose, -0.5 * vector(theta, "xyz", "_m") * columns)


def _arms(rig: Rig) -> tuple[str, ...]:
    """Arms that report joint angles."""
    return tuple(mover.name for mover in rig.movers if mover.table is not None)


def _joint_axes(circumstances: Circumstances, mover: str) -> Columns:
    """Axis of every joint of an arm in its base frame, and a point on it."""
    arm = circumstances.rig.mover(mover)
    assert arm.table is not None  # see `places`
    base_from_first, _ = ends_of(arm, circumstances.observations.motion[mover])
    joints = base_from_joints(arm.table, circumstances.observations.motion[mover])[:N_JOINTS]
    joints = tuple(base_from_first @ joint for joint in joints)
    lines = [(joint.rotation[..., 2], joint.translation_m) for joint in joints]
    return torch.cat([v.expand(len(circumstances), 3) for line in lines for v in line], dim=-1)


def _turned(pose: Transform, columns: Columns, turns_rad: Mapping[int, Tensor]) -> Transform:
    """Pose with joints turned further: the last turns first, so that each turns about where its nominal axis is."""
    for i in sorted(turns_rad, reverse=True):
        axis, on_axis_m = columns[:, 6 * i : 6 * i + 3], columns[:, 6 * i + 3 : 6 * i + 6]
        turn = rotation_from_vector(turns_rad[i][..., None] * axis)
        pose = Transform(turn, on_axis_m - (turn @ on_axis_m[..., None])[..., 0]) @ pose
    return pose


# Quantities: how far each joint stands beyond its reading.
@MotionEffect.cause(
    quantities=tuple(normal(f"q{i}_rad", "rad", 2e-3) for i in range(N_JOINTS)),
    places=_arms,
    columns=_joint_axes,
)
def joint_zeros(pose: Transform, columns: Columns, theta: Theta) -> Transform:
    """The joints' encoders have other zeros than the arm's kinematics.

    The encoders of an arm's joints do not read zero where its kinematics have their zeros.

    Source: UR arms whose factory calibration is not used, about 2 mrad a joint.
    """
    return _turned(pose, columns, {i: theta[f"q{i}_rad"][..., None] for i in range(N_JOINTS)})


# Quantities: angle by which a joint gives way for each metre of lever: the shoulder under either, the elbow under that at the flange.
@MotionEffect.cause(
    quantities=tuple(normal(key, "rad/m", 0.01) for key in SAGGING), places=_arms, columns=_joint_axes
)
def joint_sag(pose: Transform, columns: Columns, theta: Theta) -> Transform:
    """Shoulder and elbow of the arm give way under its weight.

    The gears of shoulder and elbow give way under the weight of the arm and of what it carries, so that it sags with its reach.

    A joint turns by its compliance times the torque, the lever of each weight about it: weights sit at the elbow and at the flange.
    The base stands upright; where it hangs, sizes are negative.

    Source: gears of 10 kN m/rad under 30 N: 3 mrad for each metre of lever; light arms with belts several times that.
    """
    turns_rad: dict[int, Tensor] = {}
    for key, (joint, weight) in SAGGING.items():
        axis, on_axis_m = columns[:, 6 * joint : 6 * joint + 3], columns[:, 6 * joint + 3 : 6 * joint + 6]
        at_m = pose.translation_m if weight is None else columns[:, 6 * weight + 3 : 6 * weight + 6]
        x_m, y_m, _ = (at_m - on_axis_m).unbind(-1)
        lever_m = axis[:, 1] * x_m - axis[:, 0] * y_m  # of a weight along -z
        turn_rad = theta[key][..., None] * lever_m
        turns_rad[joint] = turns_rad[joint] + turn_rad if joint in turns_rad else turn_rad
    return _turned(pose, columns, turns_rad)


# Quantities: in the frame of the base as stated.
@MotionEffect.cause(
    quantities=elsewhere(2e-3, math.radians(0.5)),
    # Displacements begin wherever the reference pose is.
    places=lambda rig: tuple(m.name for m in rig.movers if m.motion is not MotionKind.DISPLACEMENT),
)
def base_misplaced(pose: Transform, theta: Theta) -> Transform:
    """The base of the mover stands elsewhere in the room, or turned.

    The base of an arm or a mapper stands elsewhere in the room, or turned.

    Source: bases are placed by tape and level to about 2 mm and 0.5 degree.
    """
    return of_numbers(theta) @ pose


def _is_no_bump(circumstances: Circumstances, place: str) -> bool:
    """Whether the slip differs from a bump of one sensor: several sensors see the shift, or one that the mover turned."""
    rig, history = circumstances.rig, circumstances.observations.history
    carries_coil = any(coil.carried_by == place for coil in rig.coils)
    read = [rig.sensors[i] for i in history.sensor.unique().tolist()]
    shifted = [sensor for sensor in read if carries_coil or sensor.carried_by == place]
    turn = base_from_motion(rig.mover(place), history.motion[place]).rotation
    is_turned = bool((turn - turn[0]).abs().max() > LEAST_TURN)
    return len(shifted) > 1 or (is_turned and any(sensor.carried_by == place for sensor in shifted))


# Quantities: in the frame that the mover reports in.
@MotionEffect.cause(quantities=triple("xyz", "_m", "m", 500e-6), concerns=_is_no_bump)
def _mover_off(pose: Transform, theta: Theta) -> Transform:
    """The mover stands elsewhere than it says.

    The mover stands elsewhere than it says, as far everywhere.

    Source: lost steps of a motor and pushed feet, 0.1 to 1 mm.
    """
    return _shifted(pose, vector(theta, "xyz", "_m"))


@during(_mover_off)
def mover_slipped() -> None:
    """From one instant on the mover stands elsewhere than it says.

    The mover lost steps, or its feet were pushed: from one instant on it stands elsewhere than it says, as far everywhere.
    """


@spell(mover_slipped)
def mover_spell() -> None:
    """For a while the mover stands elsewhere than it says.

    For a while the mover stands elsewhere than it says, as far everywhere: another tool frame, a wrong height in part of a record.

    Source: another tool or work frame in part of a program, 0.1 to 1 mm.
    """


@MotionEffect.cause(
    **each_segment(elsewhere(1e-3, math.radians(0.5))),  # in the frame that the mover reports in
    concerns=lambda circumstances: is_several(circumstances.extent.segments),
    columns=lambda circumstances: circumstances.segment.to(circumstances.current_A.dtype)[:, None],
)
def segment_misplaced(pose: Transform, columns: Columns, theta: Theta) -> Transform:
    """In each segment of the session the mover stands elsewhere, or turned.

    The mover was set up anew before each segment, and stands elsewhere each time, or turned.

    Source: feet, stops and references are found again to about 1 mm and 0.5 degree.
    """
    segment = columns[:, 0].long()
    turn = rotation_from_vector(of_segment(theta, TURN, segment))
    return Transform(turn, of_segment(theta, SHIFT, segment)) @ pose
