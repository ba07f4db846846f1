"""How many magnetic charges stand on the surface of a box, and how the amplitudes are called that a rig holds for them."""

from __future__ import annotations

MOST_CHARGES = 3000  # a design matrix of 3000 readings is 200 MB then, and its decomposition takes a minute

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
