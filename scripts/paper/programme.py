"""The calibration programme of the paper, as its text tells it: eq 22 minimised by MATLAB's fminsearch.

What the text leaves open is an argument here: whether loops add as vectors or as eq 13 is printed, and whether the loop counts that the
search proposes are rounded. A sum from 1 to N_a needs a whole number, and the paper prints whole numbers only.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
from scipy.optimize import OptimizeResult, minimize
from scipy.spatial.transform import Rotation

from estimator.field.literal import literal_field_per_ampere
from estimator.field.winding import Winding, exact_rule, winding_field_per_ampere
from estimator.field.winding_shape import Rule
from scripts.paper import printed

RULE = Rule(10, 5, 8)  # within 1e-5 of the sum over all loops at the grids of the paper
Counts = Callable[[float], float]


def fminsearch(cost: Callable[[np.ndarray], float], start: np.ndarray) -> OptimizeResult:
    """SciPy's Nelder-Mead with MATLAB's first simplex, tolerances and limits.

    A parameter that starts at 0 is stepped by 0.00025, every other one by 5 %.
    """
    steps = np.where(start == 0.0, 0.00025, 0.05 * start)
    options = {"initial_simplex": np.vstack((start, start + np.diag(steps))), "xatol": 1e-4, "fatol": 1e-4}
    limits = {"maxiter": 200 * len(start), "maxfev": 200 * len(start)}
    return minimize(cost, start, method="Nelder-Mead", options={**options, **limits})


def winding(numbers: Sequence[float]) -> Winding:
    """Winding of external radius and wire radius in mm, axial and radial loops."""
    radius_mm, wire_mm, axial, radial = torch.tensor([float(value) for value in numbers], dtype=torch.float64)
    return Winding(1e-3 * radius_mm, axial, radial, 2e-3 * wire_mm, 2e-3 * wire_mm)


def field_per_ampere(
    points_coil_m: np.ndarray,
    numbers: np.ndarray | printed.Winding,
    counts: Counts = float,
    is_literal: bool = False,
    is_exact: bool = False,
) -> np.ndarray:
    """Field of a winding at points of its own frame, in T/A.

    Args:
        points_coil_m: Points in front of the winding, (point, 3).
        numbers: External radius and wire radius in mm, axial and radial loops.
        counts: What becomes of a count before the sum, such as `round`.
        is_literal: Whether spherical components are added, as eq 13 is printed.
        is_exact: Whether every loop is summed, which points within a few millimetres of the winding need.
    """
    points, coil = torch.from_numpy(points_coil_m), winding((*numbers[:2], *map(counts, numbers[2:4])))
    add = literal_field_per_ampere if is_literal else winding_field_per_ampere
    return add(points, coil, exact_rule(coil, points) if is_exact else RULE).numpy()


def is_possible(numbers: np.ndarray, counts: Counts = float) -> bool:
    """Whether numbers are those of a winding: positive, with at least one loop each way and a bore."""
    radius_mm, wire_mm, axial, radial = numbers[0], numbers[1], counts(numbers[2]), counts(numbers[3])
    return bool(wire_mm > 0.0 and axial >= 1 and radial >= 1 and radius_mm > 2.0 * wire_mm * radial)


def coil_from_world(pose: np.ndarray) -> np.ndarray:
    """Rotation of the coil that Table 8's angles stand for; they turn the world into the coil (errata, Table 8)."""
    return Rotation.from_euler("xyz", pose[3:]).as_matrix()


def sensor_in_coil_m(pose: np.ndarray, displacement_coil_m: np.ndarray) -> np.ndarray:
    """Where the sensor is in the coil frame after displacements of the coil along its own axes (eq 22)."""
    return -displacement_coil_m - coil_from_world(pose) @ (1e-3 * pose[:3])


def reading_per_ampere(
    numbers: np.ndarray, displacement_coil_m: np.ndarray, counts: Counts = float, is_literal: bool = False
) -> np.ndarray:
    """Field that the sensor reads, in T/A: the winding's four numbers and the pose's six (Table 8)."""
    pose = numbers[4:]
    field = field_per_ampere(sensor_in_coil_m(pose, displacement_coil_m), numbers[:4], counts, is_literal)
    return field @ coil_from_world(pose)


def box_m(n: int, nearest_m: float = 0.0) -> np.ndarray:
    """Places n x n x n in a box of 100 x 100 x 50 mm, centred on the axis; its nearest plane lies at z = `nearest_m`."""
    wide, deep = np.linspace(-0.05, 0.05, n), nearest_m + np.linspace(0.0, 0.05, n)
    return np.stack(np.meshgrid(wide, wide, deep, indexing="ij"), axis=-1).reshape(-1, 3)
