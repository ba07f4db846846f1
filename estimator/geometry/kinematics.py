"""Forward kinematics of the robots that carry coils and sensors: joint angles -> base_from_flange.

Used where readings hold joint angles; where they hold poses, the controller has done this step already.
The nominal tables give the flange of a real arm to about a millimetre only. Each arm has factory corrections,
which its controller reports; corrected values form a table of the same kind.
"""

from __future__ import annotations

from jaxtyping import Float

from estimator.errors import InvalidInput, quoted
from estimator.frames import Transform
from estimator.rig.arms import ARMS, DenavitHartenberg
from estimator.tensors import Tensor, torch


def base_from_flange(robot: DenavitHartenberg | str, joints_rad: Float[Tensor, "*batch 6"]) -> Transform:
    """Pose of the flange in the controller's base frame, as the teach pendant shows it with no tool offset.

    Args:
        robot: A name in `ARMS`, or the table of one arm with its factory corrections.
        joints_rad: Base, shoulder, elbow, wrist 1, 2, 3, as the controller reports them.
    Returns: base_from_flange over `*batch`. (In ROS this frame is `base`; `base_link` is turned by pi.)
    Raises: InvalidInput for an unknown name.
    References: see `ARMS`; J. Denavit and R. S. Hartenberg, J. Applied Mechanics 22 (1955) 215.
    Examples:
        >>> stretched_out = torch.zeros(6, dtype=torch.float64)
        >>> base_from_flange("UR3e", stretched_out).translation_m.round(decimals=5).tolist()
        [-0.45675, -0.22315, 0.0665]
    """
    return base_from_joints(robot, joints_rad)[-1]


def base_from_joints(
    robot: DenavitHartenberg | str, joints_rad: Float[Tensor, "*batch 6"]
) -> tuple[Transform, ...]:
    """Frames of the six joints in the base frame, each turning about its z axis, and last that of the flange.

    Args:
        robot, joints_rad: As for `base_from_flange`.
    Raises: InvalidInput for an unknown name.
    """
    if isinstance(robot, str):
        if robot not in ARMS:
            raise InvalidInput(f"robot must be one of {', '.join(ARMS)}; received {quoted(robot)}")
        robot = ARMS[robot]
    x, _, z = torch.eye(3, dtype=joints_rad.dtype, device=joints_rad.device)
    columns = zip(joints_rad.unbind(-1), robot.theta_rad, robot.a_m, robot.d_m, robot.alpha_rad, strict=True)
    frames = [Transform.identity(joints_rad.dtype, joints_rad.device)]
    for joint_rad, theta_rad, a_m, d_m, alpha_rad in columns:
        along_z = Transform.from_pose(d_m * z, (joint_rad[..., None] + theta_rad) * z)
        along_x = Transform.from_pose(a_m * x, alpha_rad * x)
        frames.append(frames[-1] @ along_z @ along_x)
    return tuple(frames)
