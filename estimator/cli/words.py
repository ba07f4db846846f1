"""Times and positions in words, for people at a terminal."""

from __future__ import annotations

import math
from collections.abc import Sequence

from estimator.rig.rig import MotionKind, Mover


def duration_words(time_s: float) -> str:
    """Format a duration.

    Examples:
        >>> duration_words(42.4), duration_words(125.0), duration_words(7300.0)
        ('42 s', '2 min 5 s', '2 h 1 min')
    """
    whole_s = round(time_s)
    if whole_s < 60:
        return f"{whole_s} s"
    if whole_s < 3600:
        return f"{whole_s // 60} min {whole_s % 60} s"
    return f"{whole_s // 3600} h {whole_s % 3600 // 60} min"


def motion_words(mover: Mover, motion: Sequence[float]) -> str:
    """Format the columns of a mover as its controller shows them: joint angles, or position and rotation.

    Examples:
        >>> motion_words(Mover("arm1", MotionKind.DISPLACEMENT), [0.05, -0.02, 0.0, 0.0, 0.0, 0.0])
        '50.0, -20.0, 0.0 mm'
    """
    if mover.motion in (MotionKind.UR3, MotionKind.UR3E):
        return f"{_numbers([math.degrees(angle_rad) for angle_rad in motion])}°"
    rotation_deg = [math.degrees(angle_rad) for angle_rad in motion[3:]]
    rotation = f", turned by {_numbers(rotation_deg)}°" if any(rotation_deg) else ""
    return f"{_numbers([1e3 * x_m for x_m in motion[:3]])} mm{rotation}"


def _numbers(values: Sequence[float]) -> str:
    return ", ".join(f"{round(value, 1) + 0.0:.1f}" for value in values)
