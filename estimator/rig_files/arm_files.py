"""A Denavit-Hartenberg table from the axes of six joints, which stand in a URDF or in what `ur_calibration` has extracted.

Any chain of six turning joints has such a table between two frames: one whose z axis is that of the first joint, and the one that the last
joint turns. These two stand beside the table.

The file of `ur_calibration`, a part of the ROS driver of Universal Robots, has six links with joints at zero: `x`, `y`, `z` in metres and
`roll`, `pitch`, `yaw`. The driver takes the controller's table, moves far offsets of nearly parallel axes from link to link, and writes
what is left. The kinematics stay the same, so that the table follows again.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from estimator.errors import InvalidInput, reason
from estimator.given_files import MOST_SETTINGS_BYTES, open_given
from estimator.rig.arms import ARMS, N_JOINTS, ArmEnds, DenavitHartenberg
from estimator.yaml_section import Section

PARALLEL = 1e-9  # sine of the angle between axes that count as parallel; between it and exact ones a metre is off by a nanometre

Matrix = Float[np.ndarray, "4 4"]
Vector = Float[np.ndarray, " 3"]
Axis = tuple[Vector, Vector]  # direction and a point


@dataclass(frozen=True)
class _Frame:
    """Axes and origin in the base frame, with all joints at zero."""

    x: Vector
    z: Vector
    origin_m: Vector

    @property
    def matrix(self) -> Matrix:
        """base_from_frame."""
        whole = np.eye(4)
        whole[:3] = np.column_stack((self.x, np.cross(self.z, self.x), self.z, self.origin_m))
        return whole


def table_of_axes(axes: list[Axis], base_from_flange: Matrix) -> tuple[DenavitHartenberg, ArmEnds]:
    """The table of six joints, and where base and flange are.

    Args:
        axes: Of the joints in their order, in the base frame, with all joints at zero.
        base_from_flange: Likewise.
    References: Denavit and Hartenberg, J. Applied Mechanics 22, 215 (1955), in the standard (distal) convention.
    """
    frame = _Frame(_across(axes[0][0]), *axes[0])
    base_from_first = frame.matrix
    rows = []
    for z, point_m in axes[1:]:
        row, frame = _next(frame, z, point_m)
        rows.append(row)
    columns = zip(*rows, (0.0,) * 4, strict=True)
    theta_rad, a_m, d_m, alpha_rad = (tuple(float(number) for number in column) for column in columns)
    last_from_flange = np.linalg.solve(frame.matrix, base_from_flange)
    return DenavitHartenberg(theta_rad, a_m, d_m, alpha_rad), ArmEnds(
        _pose(base_from_first), _pose(last_from_flange)
    )


def _next(frame: _Frame, z: Vector, point_m: Vector) -> tuple[tuple[float, float, float, float], _Frame]:
    """theta, a, d and alpha that lead to the next axis, and the frame on it: x along the common normal."""
    normal, apart_m = np.cross(frame.z, z), point_m - frame.origin_m
    sine = float(np.linalg.norm(normal))
    if sine > PARALLEL:
        x = normal / sine
        origin_m = point_m + z * float(np.cross(apart_m, frame.z) @ normal) / sine**2
    else:
        beside_m = apart_m - frame.z * float(frame.z @ apart_m)
        distance_m = float(np.linalg.norm(beside_m))
        x = beside_m / distance_m if distance_m > PARALLEL else frame.x
        origin_m = frame.origin_m + beside_m
    y = np.cross(frame.z, frame.x)
    theta, alpha = np.arctan2(x @ y, x @ frame.x), np.arctan2(np.cross(frame.z, z) @ x, frame.z @ z)
    way_m = origin_m - frame.origin_m
    return (float(theta), float(way_m @ x), float(way_m @ frame.z), float(alpha)), _Frame(x, z, origin_m)


def _across(z: Vector) -> Vector:
    """A unit vector across another, along x where it can be."""
    other = np.eye(3)[1 if abs(z[0]) > 0.9 else 0]
    across = other - z * float(z @ other)
    return across / np.linalg.norm(across)


def _pose(matrix: Matrix) -> tuple[float, ...]:
    """Position and rotation vector."""
    from scipy.spatial.transform import Rotation  # a third of a second, which few rig files need

    numbers = np.concatenate((matrix[:3, 3], Rotation.from_matrix(matrix[:3, :3]).as_rotvec()))
    return tuple(float(number) for number in numbers)


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


TURNING = ("revolute", "continuous")


def arm_from_urdf(path: Path, base: str, flange: str) -> tuple[DenavitHartenberg, ArmEnds]:
    """The table of the joints between two links, and where base and flange are.

    Args:
        path: URDF file; meshes that it names are not read.
        base, flange: Links at the ends of the chain: that in which the controller reports, and that which carries.
    Returns: Joints in their order from base to flange.
    Raises:
        InvalidInput: yourdfpy is not installed, the file cannot be read, or the chain is not one of six turning joints.
    References: Denavit and Hartenberg, J. Applied Mechanics 22, 215 (1955), in the standard (distal) convention.
    """
    return table_of_axes(*_axes(path, base, flange))


def _axes(path: Path, base: str, flange: str) -> tuple[list[Axis], Matrix]:
    """Direction and a point of each joint's axis in the base frame, and base_from_flange, with all joints at zero."""
    try:
        from yourdfpy import URDF
    except ImportError as error:
        raise InvalidInput(
            f"a URDF needs the extra coilcal[urdf] (pip install 'coilcal[urdf]'); received {path}"
        ) from error
    open_given(path, MOST_SETTINGS_BYTES, rule="must be a URDF that can be read").close()
    try:
        robot = URDF.load(str(path), build_scene_graph=False, load_meshes=False).robot
    except Exception as error:  # of its parser, of any type
        raise InvalidInput(f"{path} must be a URDF that can be read: {reason(error)}") from error
    above = {joint.child: joint for joint in robot.joints}
    chain: list[Any] = []
    link = flange
    while link != base and link in above and len(chain) <= len(above):
        chain.append(above[link])
        link = above[link].parent
    names = {each.name for each in robot.links}
    if link != base or not {base, flange} <= names:
        raise InvalidInput(
            f"{path} must have joints from link {base!r} to {flange!r}; it has none that join them"
        )
    here, lines = np.eye(4), []
    for joint in reversed(chain):
        here = here if joint.origin is None else here @ joint.origin
        if joint.type in TURNING and joint.mimic is None:
            axis = np.array([1.0, 0.0, 0.0] if joint.axis is None else joint.axis, dtype=float)
            lines.append((here[:3, :3] @ (axis / np.linalg.norm(axis)), here[:3, 3].copy()))
        elif joint.type != "fixed":
            raise InvalidInput(
                f"joints from {base} to {flange} must turn freely or be fixed; {joint.name} does not ({path})"
            )
    if len(lines) != N_JOINTS:
        raise InvalidInput(
            f"{path} must have {N_JOINTS} turning joints from {base} to {flange}; it has {len(lines)}"
        )
    return lines, here
