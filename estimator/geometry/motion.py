"""Poses: what the columns of a mover say, what the pose blocks of a rig say, and where bodies nominally stand."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from jaxtyping import Float
from torch import Tensor
from torch.func import jacfwd

from estimator.frames import Transform, rotation_from_vector, vector_from_rotation
from estimator.geometry.kinematics import base_from_flange
from estimator.readings.observations import Observations
from estimator.rig.rig import Body, DisplacementFrame, MotionKind, Mover, Rig

MOST_PLACES = 200
NEWTON_STEPS = 6


def base_from_motion(mover: Mover, motion: Float[Tensor, "place 6"]) -> Transform:
    """Flange pose of a mover's readings: base_from_flange, or the displacement in the end-effector frame.

    References: Osinde et al., eq 18-22; a controller that reports displacements in its base frame needs base_from_flange(q0)^T first
        (DESIGN section 2).
    """
    if mover.motion in (MotionKind.UR3, MotionKind.UR3E):
        return base_from_flange(str(mover.motion), motion)
    pose = Transform.from_pose(motion[:, :3], motion[:, 3:])
    if mover.motion is MotionKind.DISPLACEMENT and mover.displacement_frame is DisplacementFrame.BASE:
        base_from_flange0 = rotation_from_vector(
            torch.tensor(mover.reference_rotation_rad, dtype=motion.dtype)
        )
        turned = base_from_flange0.mT @ pose.rotation @ base_from_flange0
        return Transform(turned, pose.translation_m @ base_from_flange0)
    return pose


def flange_to_reach(mover: Mover, motion: Float[Tensor, "place 6"], reference: Transform) -> Transform:
    """Pose in the frame of its base that a mover must bring its flange to, to report these readings.

    Args:
        mover: Says what they mean.
        motion: Readings, as in a session or a plan.
        reference: base_from_flange where displacements are zero; other movers do without.
    """
    moved = base_from_motion(mover, motion)
    return reference @ moved if mover.motion is MotionKind.DISPLACEMENT else moved


def motion_reached(
    mover: Mover, base_from_flange: Transform, reference: Transform, near: Float[Tensor, "place 6"]
) -> Float[Tensor, "place 6"]:
    """Readings of a mover whose flange is measured at a pose: the inverse of `flange_to_reach`.

    Joint angles are those whose nominal kinematics give the pose, which is what the model makes of them again; the controller's own,
    by the calibrated kinematics of one arm, would not.

    Args:
        mover: Says what readings mean.
        base_from_flange: Measured pose.
        reference: base_from_flange where displacements are zero.
        near: Readings that were asked for; joint angles are sought from there.
    """
    if mover.motion in (MotionKind.UR3, MotionKind.UR3E):
        return torch.stack(
            [_joints(mover, base_from_flange.rows(torch.tensor([i])), q) for i, q in enumerate(near)]
        )
    is_relative = mover.motion is MotionKind.DISPLACEMENT
    pose = reference.inverse() @ base_from_flange if is_relative else base_from_flange
    if is_relative and mover.displacement_frame is DisplacementFrame.BASE:
        base_from_flange0 = rotation_from_vector(torch.tensor(mover.reference_rotation_rad, dtype=near.dtype))
        turned = base_from_flange0 @ pose.rotation @ base_from_flange0.mT
        pose = Transform(turned, pose.translation_m @ base_from_flange0.mT)
    return torch.cat((pose.translation_m, vector_from_rotation(pose.rotation)), dim=-1)


def _joints(mover: Mover, base_from_flange: Transform, near: Float[Tensor, " 6"]) -> Float[Tensor, " 6"]:
    """Newton's method on the shift and the small turn that are left."""
    target_from_base = base_from_flange.inverse()

    def left(joints_rad: Tensor) -> Tensor:
        off = target_from_base @ base_from_motion(mover, joints_rad[None])
        skew = 0.5 * (off.rotation - off.rotation.mT)[0]  # to first order the rotation vector
        return torch.cat((off.translation_m[0], torch.stack((skew[2, 1], skew[0, 2], skew[1, 0]))))

    joints_rad = near
    for _ in range(NEWTON_STEPS):
        joints_rad = joints_rad - torch.linalg.lstsq(jacfwd(left)(joints_rad), left(joints_rad)).solution
    return joints_rad


def pose_of(prefix: str, values: Mapping[str, Tensor]) -> Transform:
    """Transform of a pose block, with a row axis of 1 to broadcast over poses.

    The rotation is the rotation vector (rx, ry, rz) followed by the small rotation (tilt_x, tilt_y, spin) about the body's own axes, so
    that a coil's spin about its axis stays one parameter whatever its nominal direction.
    """

    def three(*keys: str) -> Tensor:
        return torch.stack(torch.broadcast_tensors(*(values[f"{prefix}.{key}"] for key in keys)), dim=-1)

    turn, own_turn = torch.broadcast_tensors(
        three("rx_rad", "ry_rad", "rz_rad"), three("tilt_x_rad", "tilt_y_rad", "spin_rad")
    )
    rotation, own = rotation_from_vector(torch.stack((turn, own_turn))).unbind()  # one call costs half of two
    translation_m = three("x_m", "y_m", "z_m")
    return Transform((rotation @ own)[..., None, :, :], translation_m[..., None, :])


def world_from_body(
    rig: Rig,
    body: Body,
    kind: str,
    flange: Mapping[str, Transform],
    values: Mapping[str, Tensor],
    mount_at_reference: Transform | None = None,
    mount_since: Transform | None = None,
) -> Transform:
    """Pose of a coil or sensor, given where the movers stand.

    Args:
        rig: Names the mover that carries the body.
        body, kind: The body and its kind, `coil` or `sensor`.
        flange: Per mover base_from_flange, or the displacement in the end-effector frame (`base_from_motion`).
        values: Every number of the rig.
        mount_at_reference: nominal_from_real of the body on what carries it, as it was when the reference pose was taken.
        mount_since: nominal_from_real of what has changed since.
    References: Osinde et al., eq 14-22, with displacements in the end-effector frame.
    """
    at_reference = mount_at_reference or Transform.identity()
    since = mount_since or Transform.identity()
    if body.carried_by is None:
        return pose_of(f"{body.name}.world_from_{kind}", values) @ since
    mover = rig.mover(body.carried_by)
    flange_from_body = pose_of(f"{body.name}.flange_from_{kind}", values) @ at_reference
    real = flange[mover.name] @ flange_from_body @ since
    if mover.motion is MotionKind.DISPLACEMENT:
        return pose_of(f"{body.name}.world_from_{kind}0", values) @ flange_from_body.inverse() @ real
    return pose_of(f"{mover.name}.world_from_base", values) @ real


def nominal_places_m(
    rig: Rig, observations: Observations, has_coils: bool = True
) -> Float[Tensor, "place 3"]:
    """Where sensors, and coils, nominally stand in the world during a session, a few hundred poses of each at most."""
    values = {name: torch.tensor(value, dtype=torch.float64) for name, value in rig.nominal_values().items()}
    step = max(1, len(observations) // MOST_PLACES)
    flange = {m.name: base_from_motion(m, observations.motion[m.name][::step]) for m in rig.movers}
    bodies: list[tuple[str, Body]] = [("coil", coil) for coil in rig.coils] if has_coils else []
    bodies += [("sensor", sensor) for sensor in rig.sensors]
    return torch.cat(
        [world_from_body(rig, body, kind, flange, values).translation_m for kind, body in bodies]
    )
