"""The kinematics of an arm from a URDF file, as the Denavit-Hartenberg table that a rig holds.

Any chain of six turning joints has such a table between two frames: one whose z axis is that of the first joint, and the one that the last
joint turns. These two stand beside the table, so the rig needs the file no more once it is read.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from estimator.errors import InvalidInput, reason
from estimator.rig.arms import ArmEnds, DenavitHartenberg

PARALLEL = 1e-9  # sine of the angle between axes that count as parallel; between it and exact ones a metre is off by a nanometre
TURNING = ("revolute", "continuous")
N_JOINTS = 6

Matrix = Float[np.ndarray, "4 4"]
Vector = Float[np.ndarray, " 3"]


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
    lines, base_from_flange = _axes(path, base, flange)
    frame = _Frame(_across(lines[0][0]), *lines[0])
    base_from_first = frame.matrix
    rows = []
    for z, point_m in lines[1:]:
        row, frame = _next(frame, z, point_m)
        rows.append(row)
    columns = zip(*rows, (0.0,) * 4, strict=True)
    theta_rad, a_m, d_m, alpha_rad = (tuple(float(number) for number in column) for column in columns)
    last_from_flange = np.linalg.solve(frame.matrix, base_from_flange)
    return DenavitHartenberg(theta_rad, a_m, d_m, alpha_rad), ArmEnds(
        _pose(base_from_first), _pose(last_from_flange)
    )


def _axes(path: Path, base: str, flange: str) -> tuple[list[tuple[Vector, Vector]], Matrix]:
    """Direction and a point of each joint's axis in the base frame, and base_from_flange, with all joints at zero."""
    try:
        from yourdfpy import URDF
    except ImportError as error:
        raise InvalidInput(
            f"a URDF needs the extra coilcal[urdf] (pip install 'coilcal[urdf]'); received {path}"
        ) from error
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
    unit: Vector = across / np.linalg.norm(across)
    return unit


def _pose(matrix: Matrix) -> tuple[float, ...]:
    """Position and rotation vector."""
    numbers = np.concatenate((matrix[:3, 3], Rotation.from_matrix(matrix[:3, :3]).as_rotvec()))
    return tuple(float(number) for number in numbers)
