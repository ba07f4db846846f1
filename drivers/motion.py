"""Where a flange is on its way between two poses: straight line, and rotation about one axis at an even rate."""

from __future__ import annotations

import math

from drivers.protocols import FlangePose
from drivers.rotation import inverse, product, quaternion, rotation_vector_rad


def interpolate(start: FlangePose, target: FlangePose, share: float) -> FlangePose:
    """Pose after a share of the way; 0 is the start, 1 the target.

    Examples:
        >>> home, turned = FlangePose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), FlangePose((0.2, 0.0, 0.0), (0.0, 0.0, 1.0))
        >>> interpolate(home, turned, 0.5)
        FlangePose(position_m=(0.1, 0.0, 0.0), rotation_vector_rad=(0.0, 0.0, 0.5))
    """
    x_m, y_m, z_m = (a + share * (b - a) for a, b in zip(start.position_m, target.position_m, strict=True))
    first, last = quaternion(start.rotation_vector_rad), quaternion(target.rotation_vector_rad)
    whole = rotation_vector_rad(product(inverse(first), last))
    part = quaternion((share * whole[0], share * whole[1], share * whole[2]))
    return FlangePose((x_m, y_m, z_m), rotation_vector_rad(product(first, part)))


def distance_m(start: FlangePose, target: FlangePose) -> float:
    """Length of the straight line between two origins."""
    return math.dist(start.position_m, target.position_m)
