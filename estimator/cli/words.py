"""Times and places in words, for people at a terminal."""

from __future__ import annotations

import math
from collections.abc import Sequence

from estimator.rig.rig import MotionKind, Mover


def duration(time_s: float) -> str:
    """A time in words.

    Examples:
        >>> duration(42.4), duration(125.0), duration(7300.0)
        ('42 s', '2 min 5 s', '2 h 1 min')
    """
    whole_s = round(time_s)
    if whole_s < 60:
        return f"{whole_s} s"
    if whole_s < 3600:
        return f"{whole_s // 60} min {whole_s % 60} s"
    return f"{whole_s // 3600} h {whole_s % 3600 // 60} min"


def place(mover: Mover, motion: Sequence[float]) -> str:
    """Where a mover is, as its controller shows it.

    Examples:
        >>> place(Mover("arm1", MotionKind.DISPLACEMENT), [0.05, -0.02, 0.0, 0.0, 0.0, 0.0])
        '50.0, -20.0, 0.0 mm'
    """
    if mover.motion in (MotionKind.UR3, MotionKind.UR3E):
        return f"{_numbers([math.degrees(angle_rad) for angle_rad in motion])}°"
    turned = [math.degrees(angle_rad) for angle_rad in motion[3:]]
    rotation = f", turned by {_numbers(turned)}°" if any(turned) else ""
    return f"{_numbers([1e3 * x_m for x_m in motion[:3]])} mm{rotation}"


def _numbers(values: Sequence[float]) -> str:
    return ", ".join(f"{round(value, 1) + 0.0:.1f}" for value in values)
