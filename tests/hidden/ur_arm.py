"""Where the flange of a UR arm stands, by elementary turns and shifts, and the joint angles that bring it somewhere.

References: Universal Robots, support page "DH Parameters for calculations of kinematics and dynamics".
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from tests.hidden.protocols import Array

# Of each joint: shift along its axis, then along the new x, then turn about that x.
ALONG_AXIS_M = {
    "UR3": (0.1519, 0.0, 0.0, 0.11235, 0.08535, 0.0819),
    "UR3e": (0.15185, 0.0, 0.0, 0.13105, 0.08535, 0.0921),
}
ALONG_X_M = {
    "UR3": (0.0, -0.24365, -0.21325, 0.0, 0.0, 0.0),
    "UR3e": (0.0, -0.24355, -0.2132, 0.0, 0.0, 0.0),
}
ABOUT_X_RAD = (np.pi / 2.0, 0.0, 0.0, np.pi / 2.0, -np.pi / 2.0, 0.0)
NEWTON_STEPS, LONGEST_STEP_RAD = 25, 0.2  # without a limit some poses are overshot and never met


def flange_pose(robot: str, joint_rad: Array) -> tuple[Array, Array]:
    """base_from_flange of every row of joint angles, rotation and place."""
    turn, place_m = _links(robot, joint_rad)
    return turn[-1].as_matrix(), place_m[-1]


def joints_reaching(robot: str, rotation: Array, place_m: Array, near_rad: Array) -> Array:
    """Joint angles by Newton's method on the geometric Jacobian.

    Args:
        rotation, place_m: Wanted base_from_flange.
        near_rad: Six angles from which every row starts.
    Raises:
        ValueError: The arm does not reach that far.
    """
    joint_rad = np.tile(near_rad, (len(place_m), 1))
    wanted = Rotation.from_matrix(rotation)
    for _ in range(NEWTON_STEPS):
        turn, at_m = _links(robot, joint_rad)
        missing = np.concatenate([place_m - at_m[-1], (wanted * turn[-1].inv()).as_rotvec()], axis=1)
        axes = np.stack([one.apply([0.0, 0.0, 1.0]) for one in turn[:-1]], axis=2)
        arms_m = np.stack([at_m[-1] - one for one in at_m[:-1]], axis=2)
        jacobian = np.concatenate([np.cross(axes, arms_m, axis=1), axes], axis=1)
        step_rad = np.linalg.solve(jacobian, missing[:, :, None])[:, :, 0]
        longest_rad = np.abs(step_rad).max(axis=1, keepdims=True)
        joint_rad = joint_rad + step_rad * np.minimum(1.0, LONGEST_STEP_RAD / np.maximum(longest_rad, 1e-12))
    if not np.abs(missing).max() < 1e-9:
        raise ValueError(f"{robot} does not reach a pose: {np.abs(missing).max():.2g} m or rad are left")
    return joint_rad


def _links(robot: str, joint_rad: Array) -> tuple[list[Rotation], list[Array]]:
    """Frames from the base to the flange; the axis of joint k is the z of frame k."""
    turn, place_m = [Rotation.identity(len(joint_rad))], [np.zeros((len(joint_rad), 3))]
    for k in range(6):
        about_axis = turn[-1] * Rotation.from_rotvec(joint_rad[:, k : k + 1] * [0.0, 0.0, 1.0])
        place_m.append(place_m[-1] + about_axis.apply([ALONG_X_M[robot][k], 0.0, ALONG_AXIS_M[robot][k]]))
        turn.append(about_axis * Rotation.from_rotvec([ABOUT_X_RAD[k], 0.0, 0.0]))
    return turn, place_m
