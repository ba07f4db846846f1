"""Rotation vectors (axis times angle), as Universal Robots reports orientations, and poses between two others.

Every half turn has two rotation vectors.
"""

from __future__ import annotations

import math
from typing import TypeAlias

from drivers.protocols import FlangePose, Vector

Quaternion: TypeAlias = tuple[float, float, float, float]


def quaternion(rotation_vector_rad: Vector) -> Quaternion:
    """Unit quaternion (w, x, y, z) of a rotation.

    Examples:
        >>> quaternion((0.0, 0.0, 3.141592653589793))
        (0.0, 0.0, 0.0, 1.0)
    """
    angle_rad = math.hypot(*rotation_vector_rad)
    scale = 0.5 if angle_rad < 1e-12 else math.sin(angle_rad / 2) / angle_rad
    x, y, z = rotation_vector_rad
    return math.cos(angle_rad / 2), scale * x, scale * y, scale * z


def rotation_vector_rad(rotation: Quaternion) -> Vector:
    """Rotation vector of a unit quaternion, with an angle of at most half a turn."""
    w, x, y, z = rotation if rotation[0] >= 0 else tuple(-part for part in rotation)
    sine = math.hypot(x, y, z)
    scale = 2.0 if sine < 1e-12 else 2 * math.atan2(sine, w) / sine
    return scale * x, scale * y, scale * z


def product(a: Quaternion, b: Quaternion) -> Quaternion:
    """The rotation `b` followed by `a`."""
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


def inverse(a: Quaternion) -> Quaternion:
    """The inverse rotation of a unit quaternion."""
    return a[0], -a[1], -a[2], -a[3]


def angle_between_rad(first_rad: Vector, second_rad: Vector) -> float:
    """Angle between two orientations.

    Examples:
        >>> angle_between_rad((3.1415, 0.0, 0.0), (-3.1415, 0.0, 0.0))
        0.000185
    """
    return math.hypot(*rotation_vector_rad(product(inverse(quaternion(first_rad)), quaternion(second_rad))))


def interpolate(start: FlangePose, target: FlangePose, share: float) -> FlangePose:
    """Pose after a fraction of the motion; `share` 0 is the start, 1 the target.

    Examples:
        >>> home, turned = FlangePose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), FlangePose((0.2, 0.0, 0.0), (0.0, 0.0, 1.0))
        >>> interpolate(home, turned, 0.5)
        FlangePose(position_m=(0.1, 0.0, 0.0), rotation_vector_rad=(0.0, 0.0, 0.5))
    """
    x_m, y_m, z_m = (a + share * (b - a) for a, b in zip(start.position_m, target.position_m, strict=True))
    first, last = quaternion(start.rotation_vector_rad), quaternion(target.rotation_vector_rad)
    x_rad, y_rad, z_rad = rotation_vector_rad(product(inverse(first), last))
    turn = quaternion((share * x_rad, share * y_rad, share * z_rad))
    return FlangePose((x_m, y_m, z_m), rotation_vector_rad(product(first, turn)))


def distance_m(start: FlangePose, target: FlangePose) -> float:
    """Distance between the origins of two poses."""
    return math.dist(start.position_m, target.position_m)
