"""A Denavit-Hartenberg table from the axes of six joints, wherever the file of an arm has them from.

Any chain of six turning joints has such a table between two frames: one whose z axis is that of the first joint, and the one that the last
joint turns. These two stand beside the table.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from estimator.rig.arms import ArmEnds, DenavitHartenberg

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
    unit: Vector = across / np.linalg.norm(across)
    return unit


def _pose(matrix: Matrix) -> tuple[float, ...]:
    """Position and rotation vector."""
    from scipy.spatial.transform import Rotation  # a third of a second, which few rig files need

    numbers = np.concatenate((matrix[:3, 3], Rotation.from_matrix(matrix[:3, :3]).as_rotvec()))
    return tuple(float(number) for number in numbers)
