"""Poses of a flange between two others: on a straight line, turning about one axis at a constant rate."""

from __future__ import annotations

import math

from drivers.protocols import FlangePose
from drivers.rotation import inverse, product, quaternion, rotation_vector_rad


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
