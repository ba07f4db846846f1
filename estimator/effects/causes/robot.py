"""How the real pose of a mover or a mount differs from what the record and the rig file say."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

from jaxtyping import Float

from estimator.effects.base import WHEN, Kind, Quantity, Theta, normal, since, triple
from estimator.effects.circumstances import Circumstances, Extent, is_meanwhile
from estimator.effects.stages import MotionEffect, MountEffect
from estimator.frames import Transform, rotation_from_vector
from estimator.geometry.kinematics import base_from_joints
from estimator.geometry.motion import base_from_motion, ends_of
from estimator.rig.arms import N_JOINTS
from estimator.rig.rig import MotionKind, Rig
from estimator.tensors import Tensor, torch

LEAST_TURN = 1e-6  # of a rotation matrix: below, a mover only moves
# The joint that gives way, and that at which the weight sits; None is the flange.
SAGGING: dict[str, tuple[int, int | None]] = {
    "shoulder_by_elbow_rad_per_m": (1, 2),
    "shoulder_rad_per_m": (1, None),
    "elbow_rad_per_m": (2, None),
}


def _shifted(pose: Transform, shift_m: Tensor) -> Transform:
    return Transform(pose.rotation, pose.translation_m + shift_m)


class RobotScale(MotionEffect):
    """The robot moves a fixed multiple of what it says, axis by axis."""

    name: ClassVar[str] = "robot_scale"
    words: ClassVar[str] = "the robot's axes have a wrong scale"
    source: ClassVar[str] = "uncalibrated arms err by 1 mm in 0.5 m; worn screws by per mille"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Relative excess of each axis."""
        return triple("xyz", "", "1", 0.005)

    def apply(self, pose: Transform, columns: Float[Tensor, "pose column"], theta: Theta) -> Transform:
        """Real pose."""
        scale = torch.stack([theta[axis] for axis in "xyz"], dim=-1)[..., None, :]
        return _shifted(pose, scale * pose.translation_m)


class RobotShear(MotionEffect):
    """The robot's axes are not at right angles."""

    name: ClassVar[str] = "robot_shear"
    words: ClassVar[str] = "the robot's axes are not at right angles"
    source: ClassVar[str] = "portal axes are squared to 1 mrad and better; arms err as in robot_scale"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """How far x leans along y, x along z, and y along z."""
        return tuple(normal(key, "1", 0.005) for key in ("xy", "xz", "yz"))

    def apply(self, pose: Transform, columns: Float[Tensor, "pose column"], theta: Theta) -> Transform:
        """Real pose."""
        _, y, z = pose.translation_m.unbind(-1)
        xy, xz, yz = (theta[key][..., None] for key in ("xy", "xz", "yz"))
        shift = torch.broadcast_tensors(xy * y + xz * z, yz * z, torch.zeros_like(z))
        return _shifted(pose, torch.stack(shift, dim=-1))


class PositionLag(MotionEffect):
    """The mover stops short of its target by a fixed length, along its last move."""

    name: ClassVar[str] = "position_lag"
    words: ClassVar[str] = "the mover stops short along its last move"
    source: ClassVar[str] = "in-position windows of controllers, 10 to 100 um"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Distance short of the target, in m."""
        return (normal("lag_m", "m", 200e-6),)

    def columns(self, circumstances: Circumstances, mover: str) -> Float[Tensor, "reading column"]:
        """Direction of the last move."""
        return torch.nn.functional.normalize(circumstances.last_move_m(mover), dim=-1, eps=1e-12)

    def beyond_the_moment(self, key: str) -> str | None:
        """The way to a position is history."""
        return "where the mover came from"

    def apply(self, pose: Transform, columns: Float[Tensor, "pose column"], theta: Theta) -> Transform:
        """Real pose."""
        return _shifted(pose, -theta["lag_m"][..., None, None] * columns)


class Backlash(MotionEffect):
    """Each axis stands half its play short of its target, on the side it came from."""

    name: ClassVar[str] = "backlash"
    words: ClassVar[str] = "the axes have play: the position depends on the side it was reached from"
    source: ClassVar[str] = "spindles and gears, 10 to 200 um"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Play of each axis."""
        return triple("xyz", "_m", "m", 200e-6)

    def columns(self, circumstances: Circumstances, mover: str) -> Float[Tensor, "reading column"]:
        """Side from which each axis was reached."""
        return circumstances.approach(mover)

    def beyond_the_moment(self, key: str) -> str | None:
        """The way to a position is history."""
        return "where the mover came from"

    def apply(self, pose: Transform, columns: Float[Tensor, "pose column"], theta: Theta) -> Transform:
        """Real pose."""
        play_m = torch.stack([theta[f"{axis}_m"] for axis in "xyz"], dim=-1)[..., None, :]
        return _shifted(pose, -0.5 * play_m * columns)


class JointZeros(MotionEffect):
    """The encoders of an arm's joints do not read zero where its kinematics have their zeros."""

    name: ClassVar[str] = "joint_zeros"
    words: ClassVar[str] = "the joints' encoders have other zeros than the arm's kinematics"
    source: ClassVar[str] = "UR arms whose factory calibration is not used, about 2 mrad a joint"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """How far each joint stands beyond its reading."""
        return tuple(normal(f"q{i}_rad", "rad", 2e-3) for i in range(N_JOINTS))

    def places(self, rig: Rig) -> tuple[str, ...]:
        """Arms that report joint angles."""
        return tuple(mover.name for mover in rig.movers if mover.table is not None)

    def columns(self, circumstances: Circumstances, mover: str) -> Float[Tensor, "reading column"]:
        """Axis of every joint in the base frame, and a point on it."""
        return _joint_axes(circumstances, mover)

    def apply(self, pose: Transform, columns: Float[Tensor, "pose column"], theta: Theta) -> Transform:
        """Real pose."""
        return _turned(pose, columns, {i: theta[f"q{i}_rad"][..., None] for i in range(N_JOINTS)})


class JointSag(MotionEffect):
    """The gears of shoulder and elbow give way under the weight of the arm and of what it carries, so that it sags with its reach.

    A joint turns by its compliance times the torque, the lever of each weight about it: weights sit at the elbow and at the flange.
    The base stands upright; where it hangs, sizes are negative.
    """

    name: ClassVar[str] = "joint_sag"
    words: ClassVar[str] = "shoulder and elbow of the arm give way under its weight"
    source: ClassVar[str] = (
        "gears of 10 kN m/rad under 30 N: 3 mrad for each metre of lever; light arms with belts several times that"
    )

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Angle by which a joint gives way for each metre of lever: the shoulder under either, the elbow under that at the flange."""
        return tuple(normal(key, "rad/m", 0.01) for key in SAGGING)

    def places(self, rig: Rig) -> tuple[str, ...]:
        """Arms that report joint angles."""
        return tuple(mover.name for mover in rig.movers if mover.table is not None)

    def columns(self, circumstances: Circumstances, mover: str) -> Float[Tensor, "reading column"]:
        """Axis of every joint in the base frame, and a point on it."""
        return _joint_axes(circumstances, mover)

    def apply(self, pose: Transform, columns: Float[Tensor, "pose column"], theta: Theta) -> Transform:
        """Real pose, to first order in the angles."""
        turns_rad: dict[int, Tensor] = {}
        for key, (joint, weight) in SAGGING.items():
            axis, on_axis_m = columns[:, 6 * joint : 6 * joint + 3], columns[:, 6 * joint + 3 : 6 * joint + 6]
            at_m = pose.translation_m if weight is None else columns[:, 6 * weight + 3 : 6 * weight + 6]
            x_m, y_m, _ = (at_m - on_axis_m).unbind(-1)
            lever_m = axis[:, 1] * x_m - axis[:, 0] * y_m  # of a weight along -z
            turn_rad = theta[key][..., None] * lever_m
            turns_rad[joint] = turns_rad[joint] + turn_rad if joint in turns_rad else turn_rad
        return _turned(pose, columns, turns_rad)


def _joint_axes(circumstances: Circumstances, mover: str) -> Float[Tensor, "reading column"]:
    """Axis of every joint of an arm in its base frame, and a point on it."""
    arm = circumstances.rig.mover(mover)
    assert arm.table is not None  # see `places`
    base_from_first, _ = ends_of(arm, circumstances.observations.motion[mover])
    joints = base_from_joints(arm.table, circumstances.observations.motion[mover])[:N_JOINTS]
    joints = tuple(base_from_first @ joint for joint in joints)
    lines = [(joint.rotation[..., 2], joint.translation_m) for joint in joints]
    return torch.cat([v.expand(len(circumstances), 3) for line in lines for v in line], dim=-1)


def _turned(
    pose: Transform, columns: Float[Tensor, "pose column"], turns_rad: Mapping[int, Tensor]
) -> Transform:
    """Pose with joints turned further: the last turns first, so that each turns about where its nominal axis is."""
    for i in sorted(turns_rad, reverse=True):
        axis, on_axis_m = columns[:, 6 * i : 6 * i + 3], columns[:, 6 * i + 3 : 6 * i + 6]
        turn = rotation_from_vector(turns_rad[i][..., None] * axis)
        pose = Transform(turn, on_axis_m - (turn @ on_axis_m[..., None])[..., 0]) @ pose
    return pose


class MoverSlipped(MotionEffect):
    """The mover lost steps, or its feet were pushed: from one instant on it stands elsewhere than it says, as far everywhere."""

    name: ClassVar[str] = "mover_slipped"
    words: ClassVar[str] = "from one instant on the mover stands elsewhere than it says"
    source: ClassVar[str] = "lost steps of a motor and pushed feet, 0.1 to 1 mm"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Shift in the frame that the mover reports in, and the time since the session began at which it happened."""
        return (*triple("xyz", "_m", "m", 500e-6), since(extent))

    def concerns(self, circumstances: Circumstances, mover: str) -> bool:
        """Whether the slip differs from a bump of one sensor: several sensors see the shift, or one that the mover turned."""
        rig, history = circumstances.rig, circumstances.observations.history
        carries_coil = any(coil.carried_by == mover for coil in rig.coils)
        read = [rig.sensors[i] for i in history.sensor.unique().tolist()]
        shifted = [sensor for sensor in read if carries_coil or sensor.carried_by == mover]
        turn = base_from_motion(rig.mover(mover), history.motion[mover]).rotation
        is_turned = bool((turn - turn[0]).abs().max() > LEAST_TURN)
        return len(shifted) > 1 or (is_turned and any(sensor.carried_by == mover for sensor in shifted))

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Instants with enough readings before and after."""
        return tuple({"since_h": instant_h} for instant_h in circumstances.instants_h)

    def columns(self, circumstances: Circumstances, mover: str) -> Float[Tensor, "reading column"]:
        """Time since the session began."""
        return circumstances.hours_for_instants[:, None]

    def beyond_the_moment(self, key: str) -> str | None:
        """An instant needs a session to lie in."""
        return WHEN

    def apply(self, pose: Transform, columns: Float[Tensor, "pose column"], theta: Theta) -> Transform:
        """Real pose, or real displacement."""
        is_elsewhere = is_meanwhile(columns[:, 0], theta)
        shift_m = torch.stack([theta[f"{axis}_m"] for axis in "xyz"], dim=-1)[..., None, :]
        return _shifted(pose, is_elsewhere[..., None] * shift_m)


class MountTilt(MountEffect):
    """The body sits turned on its flange, so that the mover's displacements run askew in its frame."""

    name: ClassVar[str] = "mount_tilt"
    is_at_reference: ClassVar[bool] = True
    kind: ClassVar[Kind] = Kind.MOVER
    words: ClassVar[str] = (
        "the body sits askew on its flange: displacements run in other directions than assumed"
    )
    source: ClassVar[str] = "a printed or bolted mount, 1 to 2 degrees"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Rotation vector across the body's axis; a turn about it is absorbed by the pose (docs/explanation/field-model.md)."""
        return (normal("x_rad", "rad", math.radians(1.5)), normal("y_rad", "rad", math.radians(1.5)))

    def places(self, rig: Rig) -> tuple[str, ...]:
        """Bodies that a displaced or joint-driven mover carries."""
        carried = [body for body in (*rig.coils, *rig.sensors) if body.carried_by is not None]
        return tuple(
            b.name for b in carried if rig.mover(str(b.carried_by)).motion is MotionKind.DISPLACEMENT
        )

    def apply(self, columns: Float[Tensor, "pose column"], theta: Theta) -> Transform:
        """nominal_from_real of the mount."""
        zero = torch.zeros_like(theta["x_rad"])
        rotation = rotation_from_vector(torch.stack((theta["x_rad"], theta["y_rad"], zero), dim=-1))
        return Transform(rotation[..., None, :, :], rotation.new_zeros(1, 3))


class SensorBumped(MountEffect):
    """Somebody touched the sensor: from one instant on it sits elsewhere."""

    name: ClassVar[str] = "sensor_bumped"
    is_at_reference: ClassVar[bool] = False
    is_step: ClassVar[bool] = True
    kind: ClassVar[Kind] = Kind.SENSOR
    words: ClassVar[str] = "from one instant on the sensor sits elsewhere"
    source: ClassVar[str] = "a touch moves a clamped probe by 0.1 to 1 mm"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Shift in the sensor's frame, and the time since the session began at which it happened."""
        return (
            *triple("xyz", "_m", "m", 500e-6),
            since(extent),
        )

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Instants with enough readings before and after."""
        return tuple({"since_h": instant_h} for instant_h in circumstances.instants_h)

    def columns(
        self, circumstances: Circumstances, theta: Mapping[str, float]
    ) -> Float[Tensor, "reading column"]:
        """1 at readings from the instant on, else 0."""
        return (circumstances.hours >= theta["since_h"]).to(circumstances.hours)[:, None]

    def beyond_the_moment(self, key: str) -> str | None:
        """An instant needs a session to lie in."""
        return WHEN

    def apply(self, columns: Float[Tensor, "pose column"], theta: Theta) -> Transform:
        """nominal_from_real of the sensor."""
        shift = torch.stack([theta[f"{axis}_m"] for axis in "xyz"], dim=-1)[..., None, :] * columns
        return Transform(torch.eye(3, dtype=shift.dtype, device=shift.device).expand(1, 3, 3), shift)
