"""Times and positions in words, for people at a terminal."""

from __future__ import annotations

import math
from collections.abc import Sequence

from estimator.rig.bodies import Mover
from estimator.rig.parameters import LogNormal, Normal, Prior


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


def prior_words(prior: Prior, factor: float = 1.0, unit: str = "") -> str:
    """Format a prior, its values times a factor and with a unit.

    Examples:
        >>> prior_words(Normal(0.05, 0.003, lower=0.04), 1e3), prior_words(LogNormal(2e-5, 0.5), 1e6)
        ('50 ± 3, at least 40', 'median 20, relative sd 0.5')
        >>> prior_words(Normal(0.05, 0.003, lower=0.04), 1e3, "mm"), prior_words(LogNormal(2e-5, 0.5), 1e6, "uT")
        ('50 ± 3, at least 40 mm', 'median 20 uT, relative sd 0.5')
    """
    unit = f" {unit}" if unit else ""
    if isinstance(prior, LogNormal):
        return f"median {factor * prior.median:g}{unit}, relative sd {prior.relative_sd:.3g}"
    low, high = factor * prior.lower, factor * prior.upper
    if isinstance(prior, Normal):
        at_least = f", at least {low:g}" if math.isfinite(low) else ""
        at_most = f", at most {high:g}" if math.isfinite(high) else ""
        return f"{factor * prior.mean:g} ± {factor * prior.standard_deviation:.3g}{at_least}{at_most}{unit}"
    return f"{low:.3g} to {high:.3g}{unit}"


def motion_words(mover: Mover, motion: Sequence[float]) -> str:
    """Format the columns of a mover as its controller shows them: joint angles, or position and rotation.

    Examples:
        >>> from estimator.rig.bodies import MotionKind
        >>> motion_words(Mover("arm1", MotionKind.DISPLACEMENT), [0.05, -0.02, 0.0, 0.0, 0.0, 0.0])
        '50.0, -20.0, 0.0 mm'
    """
    if mover.table is not None:
        return f"{_numbers([math.degrees(angle_rad) for angle_rad in motion])}°"
    rotation_deg = [math.degrees(angle_rad) for angle_rad in motion[3:]]
    rotation = f", turned by {_numbers(rotation_deg)}°" if any(rotation_deg) else ""
    return f"{_numbers([1e3 * x_m for x_m in motion[:3]])} mm{rotation}"


def _numbers(values: Sequence[float]) -> str:
    return ", ".join(f"{round(value, 1) + 0.0:.1f}" for value in values)
