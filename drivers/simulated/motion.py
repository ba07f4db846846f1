"""Where a flange is on its way between two poses: straight line, and rotation about one axis at an even rate."""

from __future__ import annotations

import math

from drivers.protocols import FlangePose, Vector

_Quaternion = tuple[float, float, float, float]


def interpolate(start: FlangePose, target: FlangePose, share: float) -> FlangePose:
    """Pose after a share of the way; 0 is the start, 1 the target.

    Examples:
        >>> home, turned = FlangePose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), FlangePose((0.2, 0.0, 0.0), (0.0, 0.0, 1.0))
        >>> interpolate(home, turned, 0.5)
        FlangePose(position_m=(0.1, 0.0, 0.0), rotation_vector_rad=(0.0, 0.0, 0.5))
    """
    x_m, y_m, z_m = (a + share * (b - a) for a, b in zip(start.position_m, target.position_m, strict=True))
    first, last = _quaternion(start.rotation_vector_rad), _quaternion(target.rotation_vector_rad)
    inverse = (first[0], -first[1], -first[2], -first[3])
    whole = _rotation_vector(_product(inverse, last))
    part = _quaternion((share * whole[0], share * whole[1], share * whole[2]))
    return FlangePose((x_m, y_m, z_m), _rotation_vector(_product(first, part)))


def distance_m(start: FlangePose, target: FlangePose) -> float:
    """Length of the straight line between two origins."""
    return math.dist(start.position_m, target.position_m)


def _quaternion(rotation_vector_rad: Vector) -> _Quaternion:
    angle_rad = math.hypot(*rotation_vector_rad)
    scale = 0.5 if angle_rad < 1e-12 else math.sin(angle_rad / 2) / angle_rad
    x, y, z = rotation_vector_rad
    return math.cos(angle_rad / 2), scale * x, scale * y, scale * z


def _rotation_vector(quaternion: _Quaternion) -> Vector:
    w, x, y, z = quaternion if quaternion[0] >= 0 else tuple(-part for part in quaternion)
    sine = math.hypot(x, y, z)
    scale = 2.0 if sine < 1e-12 else 2 * math.atan2(sine, w) / sine
    return scale * x, scale * y, scale * z


def _product(a: _Quaternion, b: _Quaternion) -> _Quaternion:
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )
