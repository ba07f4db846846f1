"""Number of magnetic charges on the surface of a box, and names of the amplitudes of charges and of multipoles."""

from __future__ import annotations

import math

from estimator.rig.harmonic_terms import amplitude_key

MOST_CHARGES = 3000  # a design matrix of 3000 readings is 200 MB then, and its decomposition takes a minute
MULTIPOLE_DEGREE = 2  # of multipoles beside the box: dipole and quadrupole

Triple = tuple[float, float, float]


def intervals(half_m: Triple, margin_m: float, spacing_m: float) -> tuple[int, int, int]:
    """Intervals between charges along each edge of the box that lies outside another by a margin.

    Args:
        half_m: Half of each edge of the box inside.
        margin_m: Between the two.
        spacing_m: Wanted distance of neighbouring charges; edges hold a whole number of intervals.

    Examples:
        >>> intervals((5e-3, 5e-3, 5e-3), 4e-3, 1.3e-3)
        (14, 14, 14)
    """
    x, y, z = (max(1, round(2.0 * (half + margin_m) / spacing_m)) for half in half_m)
    return x, y, z


def n_charges(intervals: tuple[int, int, int]) -> int:
    """Grid points on the surface of a box.

    Examples:
        >>> n_charges((1, 1, 1)), n_charges((2, 2, 2))
        (8, 26)
    """
    x, y, z = intervals
    return (x + 1) * (y + 1) * (z + 1) - (x - 1) * (y - 1) * (z - 1)


def charge_key(number: int) -> str:
    """Key of an amplitude of a coil, in tesla per ampere.

    Examples:
        >>> charge_key(1)
        'charge1_T_per_A'
    """
    return f"charge{number}_T_per_A"


def gap_m(place_m: Triple, half_m: Triple) -> float:
    """Distance of a place from a box about the origin; 0 inside.

    Examples:
        >>> gap_m((0.0, 0.04, 0.01), (0.01, 0.01, 0.01))
        0.03
    """
    return math.hypot(*(max(0.0, abs(x) - half) for x, half in zip(place_m, half_m, strict=True)))


def multipole_key(number: int, degree: int, term: str) -> str:
    """Key of an amplitude of a multipole, in tesla per ampere.

    Examples:
        >>> multipole_key(2, 1, "cos0")
        'multipole2_degree1_cos0_T_per_A'
    """
    return f"multipole{number}_{amplitude_key(degree, term)}"
