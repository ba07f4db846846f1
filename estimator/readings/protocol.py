"""The recommended protocol: which currents to set, and in which order to visit poses.

Zero current shows fields that are not the coil's, the sign shows what the sensor adds, a second magnitude shows saturation and heating. A
random order shows drift, and poses visited again show when it happened (docs/explanation/what-cannot-be-told-apart.md).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

LEVELS = (0.5, -0.5, 1.0, -1.0)  # fractions of the largest current

ORDERS = ("raster", "random", "mixed")


def recommended_currents_A(largest_A: Mapping[str, float]) -> tuple[Mapping[str, float], ...]:
    """No current, and each coil alone at two magnitudes and both signs.

    Examples:
        >>> recommended_currents_A({"coil1": 3.0})
        ({}, {'coil1': 1.5}, {'coil1': -1.5}, {'coil1': 3.0}, {'coil1': -3.0})
    """
    return ({}, *({name: level * largest_A[name]} for name in largest_A for level in LEVELS))


def visits(n_poses: int, n_revisited: int, order: str, rng: np.random.Generator) -> list[tuple[int, int]]:
    """Indices of poses in the order of their visits, each with the number of the visit.

    Args:
        n_poses: Number of poses.
        n_revisited: Number of poses, the first ones in the order, that are visited again half-way and at the end.
        order: `raster` keeps the order of the file; any other is random.
        rng: Source of the random order.

    Examples:
        >>> visits(4, 1, "raster", np.random.default_rng(0))
        [(0, 0), (1, 0), (0, 1), (2, 0), (3, 0), (0, 2)]
    """
    poses = list(range(n_poses)) if order == "raster" else rng.permutation(n_poses).tolist()
    half = (n_poses + 1) // 2
    again = poses[: min(n_revisited, n_poses)]
    parts = ((poses[:half], 0), (again, 1), (poses[half:], 0), (again, 2))
    return [(pose, number) for part, number in parts for pose in part]
