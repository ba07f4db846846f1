"""Factory corrections of an arm of Universal Robots from the file that `ur_calibration`, a part of its ROS driver, extracts.

The file has the six links with joints at zero: `x`, `y`, `z` in metres and `roll`, `pitch`, `yaw`. The driver takes the controller's
Denavit-Hartenberg table, moves far offsets of nearly parallel axes from link to link, and writes what is left. The kinematics stay the
same, so that the table follows again.
"""

from __future__ import annotations

from dataclasses import astuple
from pathlib import Path

import numpy as np

from estimator.errors import InvalidInput
from estimator.rig.arms import ARMS, DenavitHartenberg
from estimator.rig_files.joint_axes import Axis, Matrix, table_of_axes
from estimator.yaml_section import Section

LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
NUMBERS = ("x", "y", "z", "roll", "pitch", "yaw")
ASKEW = 1e-6  # rad or m by which the first axis may miss that of the base
ANOTHER_ARM_M = 0.02  # by which links of one model never differ from their table


def corrections_from_ros(path: Path, robot: str) -> DenavitHartenberg:
    """What a file of `ur_calibration` adds to the nominal table.

    Args:
        path: YAML with `kinematics: {shoulder: {x, y, z, roll, pitch, yaw}, upper_arm: ..., ...}`; `hash` and other keys are left aside.
        robot: A name in `ARMS`.
    Raises:
        InvalidInput: The file cannot be read, lacks a number, or belongs to an arm of another model.
    References: Universal_Robots_ROS2_Driver, ur_calibration/src/calibration.cpp; angles are `eulerAngles(0, 1, 2)` of Eigen, Rx Ry Rz.
    """
    base_from_flange = np.eye(4)
    axes: list[Axis] = []
    for link in _links(path):
        base_from_flange = base_from_flange @ link
        axes.append((base_from_flange[:3, 2].copy(), base_from_flange[:3, 3].copy()))
    first = axes[0]
    if abs(first[0] - (0.0, 0.0, 1.0)).max() > ASKEW or abs(first[1][:2]).max() > ASKEW:
        raise InvalidInput(
            f"kinematics.shoulder must turn about the z axis of the base; it does not ({path})"
        )
    axes[0] = (np.array([0.0, 0.0, 1.0]), np.zeros(3))
    table, ends = table_of_axes(axes, base_from_flange)
    last = ends.last_from_flange  # along and about the axis of the last joint: what its row is there for
    theta_rad, d_m = (*table.theta_rad[:5], last[5]), (*table.d_m[:5], last[2])
    whole = DenavitHartenberg(theta_rad, table.a_m, d_m, table.alpha_rad)
    nominal = ARMS[robot]
    reach_m = [sum(map(abs, each.a_m)) for each in (whole, nominal)]
    if abs(reach_m[0] - reach_m[1]) > ANOTHER_ARM_M:
        raise InvalidInput(
            f"{path} must be of a {robot}, whose arm is {reach_m[1]:.3f} m long; it is of one with {reach_m[0]:.3f} m"
        )
    columns = (
        tuple(own - known for own, known in zip(*both, strict=True))
        for both in zip(astuple(whole), astuple(nominal), strict=True)
    )
    theta, a, d, alpha = columns
    turns = (tuple(float(np.arctan2(np.sin(x), np.cos(x))) for x in angles) for angles in (theta, alpha))
    theta, alpha = turns
    return DenavitHartenberg(theta, a, d, alpha)


def _links(path: Path) -> list[Matrix]:
    """Transforms of each link in the one before, with its joint at zero."""
    from scipy.spatial.transform import Rotation  # a third of a second, which few rig files need

    links = Section.from_file(path).section("kinematics")
    transforms = []
    for name in LINKS:
        link = links.section(name)
        numbers = [link.number(key) for key in NUMBERS]
        matrix = np.eye(4)
        matrix[:3, 3] = numbers[:3]
        matrix[:3, :3] = Rotation.from_euler("XYZ", numbers[3:]).as_matrix()
        transforms.append(matrix)
    return transforms
