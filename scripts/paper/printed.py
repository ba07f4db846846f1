"""Tables 1 to 10 of the paper as data, digit for digit, in the units of the paper.

Osinde, Etievant, Byiringiro and Andreff, "Calibration of a multi-mobile coil magnetic manipulation system utilizing a control-oriented
magnetic model". Numbers are strings where their digits matter: a printed number stands for all numbers that round to it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

LEVELS_MM = {"radius": (48.0, 54.0), "wire_radius": (0.46, 0.52)}  # Table 1, seven levels each
LEVELS_COUNT = {"axial_loops": (45, 51), "radial_loops": (22, 28)}
REDUCTION_PERCENT = {"SQP": 88.4830, "genetic algorithm": 94.1784, "Nelder-Mead": 96.4259}  # Table 2

Winding = tuple[float, float, float, float]  # external radius and wire radius in mm, axial and radial loops
SIMULATED_TRUTH: Winding = (51.0, 0.49, 48, 25)  # Table 3
SIMULATED_START: Winding = (48.0, 0.46, 45, 22)
SIMULATED_FOUND: Winding = (50.069, 0.4521, 52, 23)
MEASURED: Winding = (46.5, 0.30, 115, 54)  # Table 8, from physical measurements
CALIBRATED: Winding = (53.32, 0.346, 110, 46)
Pose = tuple[float, float, float, float, float, float]  # translation in mm, rotations about x, y, z in rad
MEASURED_POSE: Pose = (-42.0, -26.0, 17.0, 1.57, 0.0, 0.0)
CALIBRATED_POSE: Pose = (-31.78, -36.20, 22.00, 1.748, 0.0, 0.0)


@dataclass(frozen=True)
class Errors:
    """One line of Tables 4 and 5, 6 and 7 or 9 and 10: errors in tesla, the same as relative errors, and the reduction in per cent."""

    where: str
    quantity: str
    n_readings: int
    before_T: str
    after_T: str
    relative_before: str
    relative_after: str
    reduction_percent: str


ERRORS = (
    Errors("Tables 4, 5", "largest", 8000, "0.0049", "0.0033", "0.0097", "0.0066", "33"),
    Errors("Tables 4, 5", "rms", 8000, "1.1000e-03", "4.2622e-04", "0.0027", "0.0008", "64"),
    Errors("Tables 6, 7", "largest", 8000, "7.7020e-04", "4.0204e-04", "0.0027", "0.0014", "48"),
    Errors("Tables 6, 7", "rms", 8000, "4.7405e-04", "1.8549e-04", "0.0017", "0.0006", "65"),
    Errors("Tables 9, 10", "largest", 512, "0.0092", "0.0074", "0.0885", "0.0674", "23"),
    Errors("Tables 9, 10", "rms", 512, "0.0043", "0.0027", "0.0414", "0.0260", "37"),
)


def interval(printed: str) -> tuple[float, float]:
    """All numbers that round to a printed one.

    Examples:
        >>> interval("0.0027")
        (0.00265, 0.00275)
        >>> interval("4.2622e-04")
        (0.000426215, 0.000426225)
    """
    mantissa, _, exponent = printed.partition("e")
    half = 0.5 * 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))
    digits = 3 - math.floor(math.log10(half))
    return round(float(printed) - half, digits), round(float(printed) + half, digits)


def reduction_percent(before: str, after: str) -> tuple[float, float]:
    """Least and largest reduction that two printed numbers allow, in per cent.

    Examples:
        >>> [round(value, 1) for value in reduction_percent("0.0043", "0.0027")]
        [35.3, 39.1]
    """
    (low_before, high_before), (low_after, high_after) = interval(before), interval(after)
    return 100.0 * (1.0 - high_after / low_before), 100.0 * (1.0 - low_after / high_before)
