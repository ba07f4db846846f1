"""The recommended way to measure: which currents to set, and the order in which places are visited.

Zero current shows what is not the coil's, the sign what the sensor adds, a second magnitude what saturates or heats, a random order what
drifts, and places visited again when it did (DESIGN section 4).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

LEVELS = (0.5, -0.5, 1.0, -1.0)  # of the largest current

ORDERS = ("raster", "random", "mixed")


def recommended_currents_A(largest_A: Mapping[str, float]) -> tuple[Mapping[str, float], ...]:
    """No current, and each coil alone at two magnitudes and both signs.

    Examples:
        >>> recommended_currents_A({"coil1": 3.0})
        ({}, {'coil1': 1.5}, {'coil1': -1.5}, {'coil1': 3.0}, {'coil1': -3.0})
    """
    return ({}, *({name: level * largest_A[name]} for name in largest_A for level in LEVELS))


def visits(n_places: int, n_revisited: int, order: str, rng: np.random.Generator) -> list[tuple[int, int]]:
    """Places in the order of the visit, each with the number of the visit.

    Args:
        n_places: How many there are.
        n_revisited: How many of them, the first ones, are visited again half-way and at the end.
        order: In the order of the file with `raster`, else by chance.
        rng: Decides.

    Examples:
        >>> visits(4, 1, "raster", np.random.default_rng(0))
        [(0, 0), (1, 0), (0, 1), (2, 0), (3, 0), (0, 2)]
    """
    places = list(range(n_places)) if order == "raster" else rng.permutation(n_places).tolist()
    half = (n_places + 1) // 2
    again = places[: min(n_revisited, n_places)]
    parts = ((places[:half], 0), (again, 1), (places[half:], 0), (again, 2))
    return [(place, number) for part, number in parts for place in part]
