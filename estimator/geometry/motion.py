"""Poses from the columns of a mover and from the pose blocks of a rig, and nominal positions of bodies."""

from __future__ import annotations

from collections.abc import Mapping

from jaxtyping import Float

from estimator.derivatives import jacobian_of
from estimator.frames import Transform, rotation_from_vector, vector_from_rotation
from estimator.geometry.kinematics import base_from_flange
from estimator.least_squares import least_squares
from estimator.readings.observations import Observations
from estimator.rig.bodies import Body, DisplacementFrame, MotionKind, Mover
from estimator.rig.coordinates import nominal_tensors
from estimator.rig.rig import Rig
from estimator.tensors import Tensor, torch

MOST_POSES = 200
NEWTON_STEPS = 6


def base_from_motion(mover: Mover, motion: Float[Tensor, "pose 6"]) -> Transform:
    """Flange pose from a mover's readings: base_from_flange, or the displacement in the end-effector frame.

    References: Osinde et al., eq 18-22; a controller that reports displacements in its base frame needs base_from_flange(q0)^T first
        (docs/explanation/field-model.md).
    """
    if mover.table is not None:
        base_from_first, last_from_flange = ends_of(mover, motion)
        return base_from_first @ base_from_flange(mover.table, motion) @ last_from_flange
    pose = Transform.from_pose(motion[:, :3], motion[:, 3:])
    if mover.motion is MotionKind.DISPLACEMENT and mover.displacement_frame is DisplacementFrame.BASE:
        base_from_flange0 = rotation_from_vector(motion.new_tensor(mover.reference_rotation_rad))
        rotation = base_from_flange0.mT @ pose.rotation @ base_from_flange0
        return Transform(rotation, pose.translation_m @ base_from_flange0)
    return pose


def ends_of(mover: Mover, like: Tensor) -> tuple[Transform, Transform]:
    """Transforms before and after the table of an arm, of the kind of another tensor; the identity where there are none."""
    if mover.own_ends is None:
        return Transform.identity(like.dtype, like.device), Transform.identity(like.dtype, like.device)
    before, after = (
        like.new_tensor(pose) for pose in (mover.own_ends.base_from_first, mover.own_ends.last_from_flange)
    )
    return Transform.from_pose(before[:3], before[3:]), Transform.from_pose(after[:3], after[3:])


def flange_to_reach(mover: Mover, motion: Float[Tensor, "pose 6"], reference: Transform) -> Transform:
    """Pose in its base frame to which a mover must bring its flange, so that it reports these readings.

    Args:
        mover: Defines the meaning of the readings.
        motion: Readings, as in a session or a plan.
        reference: base_from_flange at zero displacement; used by movers that report displacements only.
    """
    pose = base_from_motion(mover, motion)
    return reference @ pose if mover.motion is MotionKind.DISPLACEMENT else pose


def motion_reached(
    mover: Mover, base_from_flange: Transform, reference: Transform, near: Float[Tensor, "pose 6"]
) -> Float[Tensor, "pose 6"]:
    """Readings of a mover from the measured pose of its flange: the inverse of `flange_to_reach`.

    Joint angles are those whose nominal kinematics give the pose, as in the model. The controller's angles, which belong to the calibrated
    kinematics of one arm, would give another pose there.

    Args:
        mover: Defines the meaning of the readings.
        base_from_flange: Measured pose.
        reference: base_from_flange at zero displacement.
        near: Commanded readings, from which the search for joint angles starts.
    """
    if mover.table is not None:
        return torch.stack(
            [
                _joints_reaching(mover, base_from_flange.rows(torch.tensor([i], device=near.device)), q)
                for i, q in enumerate(near)
            ]
        )
    is_relative = mover.motion is MotionKind.DISPLACEMENT
    pose = reference.inverse() @ base_from_flange if is_relative else base_from_flange
    if is_relative and mover.displacement_frame is DisplacementFrame.BASE:
        base_from_flange0 = rotation_from_vector(near.new_tensor(mover.reference_rotation_rad))
        rotation = base_from_flange0 @ pose.rotation @ base_from_flange0.mT
        pose = Transform(rotation, pose.translation_m @ base_from_flange0.mT)
    return torch.cat((pose.translation_m, vector_from_rotation(pose.rotation)), dim=-1)


def _joints_reaching(
    mover: Mover, base_from_flange: Transform, near: Float[Tensor, " 6"]
) -> Float[Tensor, " 6"]:
    """Joint angles of a pose, by Newton's method on the remaining shift and small rotation."""
    target_from_base = base_from_flange.inverse()

    def pose_error(joints_rad: Tensor) -> Tensor:
        target_from_flange = target_from_base @ base_from_motion(mover, joints_rad[None])
        rotation = target_from_flange.rotation
        skew = 0.5 * (rotation - rotation.mT)[0]  # to first order the rotation vector
        return torch.cat(
            (target_from_flange.translation_m[0], torch.stack((skew[2, 1], skew[0, 2], skew[1, 0])))
        )

    joints_rad = near
    for _ in range(NEWTON_STEPS):
        jacobian = jacobian_of(pose_error, joints_rad)
        joints_rad = joints_rad - least_squares(jacobian, pose_error(joints_rad))
    return joints_rad


def pose_of(prefix: str, values: Mapping[str, Tensor]) -> Transform:
    """Transform of a pose block, with a pose axis of length 1 that broadcasts.

    The rotation is the rotation vector (rx, ry, rz) followed by the small rotation (tilt_x, tilt_y, spin) about the body's own axes, so
    that a coil's spin about its axis is one parameter for any nominal direction.
    """

    def vector(*keys: str) -> Tensor:
        return torch.stack(torch.broadcast_tensors(*(values[f"{prefix}.{key}"] for key in keys)), dim=-1)

    nominal_rad = vector("rx_rad", "ry_rad", "rz_rad")
    body_rad = vector("tilt_x_rad", "tilt_y_rad", "spin_rad")
    if nominal_rad.shape == body_rad.shape and nominal_rad.requires_grad == body_rad.requires_grad:
        # One call costs half of two.
        nominal, about_body_axes = rotation_from_vector(torch.stack((nominal_rad, body_rad))).unbind()
    else:  # what is fixed has neither batch nor derivatives
        nominal, about_body_axes = rotation_from_vector(nominal_rad), rotation_from_vector(body_rad)
    translation_m = vector("x_m", "y_m", "z_m")
    return Transform((nominal @ about_body_axes)[..., None, :, :], translation_m[..., None, :])


def world_from_body(
    rig: Rig,
    body: Body,
    kind: str,
    flange: Mapping[str, Transform],
    values: Mapping[str, Tensor],
    mount_at_reference: Transform | None = None,
    mount_since: Transform | None = None,
) -> Transform:
    """Pose of a coil or sensor in the world, from the poses of the movers.

    Args:
        rig: Names the mover that carries the body.
        body, kind: The body and its kind, `coil` or `sensor`.
        flange: For each mover base_from_flange, or the displacement in the end-effector frame (`base_from_motion`).
        values: Every parameter of the rig.
        mount_at_reference: nominal_from_real of the body on its carrier at the time of the reference pose.
        mount_since: nominal_from_real of changes since then.
    References: Osinde et al., eq 14-22, with displacements in the end-effector frame.
    """
    # One row stands for all as long as it can: products of what stands still come before those by row.
    if body.carried_by is None:
        own = pose_of(f"{body.name}.world_from_{kind}", values)
        return own if mount_since is None else own @ mount_since
    mover = rig.mover(body.carried_by)
    at_reference = pose_of(f"{body.name}.flange_from_{kind}", values)
    if mount_at_reference is not None:
        at_reference = at_reference @ mount_at_reference
    flange_from_body = at_reference if mount_since is None else at_reference @ mount_since
    if mover.motion is MotionKind.DISPLACEMENT:
        world_from_flange0 = pose_of(f"{body.name}.world_from_{kind}0", values) @ at_reference.inverse()
        return world_from_flange0 @ (flange[mover.name] @ flange_from_body)
    return pose_of(f"{mover.name}.world_from_base", values) @ (flange[mover.name] @ flange_from_body)


def nominal_positions_m(
    rig: Rig, observations: Observations, has_coils: bool = True
) -> Float[Tensor, "position 3"]:
    """Nominal world positions of sensors, and of coils, in a session; at most a few hundred poses of each."""
    values = nominal_tensors(rig, observations.current_A)
    step = max(1, len(observations) // MOST_POSES)
    flange = {m.name: base_from_motion(m, observations.motion[m.name][::step]) for m in rig.movers}
    bodies: list[tuple[str, Body]] = [("coil", coil) for coil in rig.coils] if has_coils else []
    bodies += [("sensor", sensor) for sensor in rig.sensors]
    return torch.cat(
        [world_from_body(rig, body, kind, flange, values).translation_m for kind, body in bodies]
    )
