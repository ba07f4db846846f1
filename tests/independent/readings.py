"""Readings made by other code than coilcal's: loops by magpylib, poses and noise in plain NumPy.

Nothing here imports `estimator`, so that a mistake in its field or frames cannot hide by being made twice.
"""

from __future__ import annotations

from collections.abc import Mapping

import magpylib as magpy
import numpy as np
from scipy.spatial.transform import Rotation


def coil_field_T(
    points_coil_m: np.ndarray,
    radius_m: float,
    wire_radius_m: float,
    axial_loops: int,
    radial_loops: int,
    current_A: float,
) -> np.ndarray:
    """Sum over all loops of a square-packed winding behind its front face (paper, eq 9-10), in the coil frame."""
    total = np.zeros_like(points_coil_m)
    for layer in range(radial_loops):
        loop = magpy.current.Circle(
            diameter=2.0 * (radius_m - wire_radius_m - 2.0 * wire_radius_m * layer), current=current_A
        )
        for turn in range(axial_loops):
            height_m = -(wire_radius_m + 2.0 * wire_radius_m * turn)
            total += loop.getB(points_coil_m - [0.0, 0.0, height_m])
    return total


def perfect_readings_T(
    truth: Mapping[str, float], displacement_m: np.ndarray, current_A: float, distance_m: float | None = None
) -> np.ndarray:
    """What a sensor at the room's origin reads while coil1 is displaced without turning (paper, eq 18-22).

    Args:
        truth: Winding and, where `distance_m` is not given, pose of coil1 under coilcal's parameter names.
        displacement_m: Displacements in the end-effector frame, which is parallel to the coil's.
        current_A: Current in the coil.
        distance_m: Coil on the axis at this distance, not tilted.
    """
    if distance_m is None:
        position = np.array([truth[f"coil1.world_from_coil0.{axis}_m"] for axis in "xyz"])
        tilt = [truth[f"coil1.world_from_coil0.tilt_{axis}_rad"] for axis in "xy"]
        rotation = Rotation.from_rotvec([*tilt, 0.0]).as_matrix()
    else:
        position, rotation = np.array([0.0, 0.0, -distance_m]), np.eye(3)
    points_coil_m = -displacement_m - position @ rotation
    winding = [truth[f"coil1.{key}"] for key in ("radius_m", "wire_radius_m")]
    counts = [round(truth[f"coil1.{key}_loops"]) for key in ("axial", "radial")]
    field_coil_T = coil_field_T(points_coil_m, *winding, *counts, current_A)
    return field_coil_T @ rotation.T


def displaced_coil_field_T(
    truth: Mapping[str, float], coil: str, turn_rad: np.ndarray, shift_m: np.ndarray, points_m: np.ndarray
) -> np.ndarray:
    """Field per ampere in the room of one of several coils, displaced without turning (paper, eq 14-22).

    Args:
        truth: Winding and pose of the coil under coilcal's parameter names.
        coil: Its name.
        turn_rad: Rotation vector of its nominal orientation, which small tilts about its own axes follow.
        shift_m: Displacement in the end-effector frame, which is parallel to the coil's.
        points_m: In the room.
    """
    pose = f"{coil}.world_from_coil0"
    tilt_rad = [truth[f"{pose}.tilt_x_rad"], truth[f"{pose}.tilt_y_rad"], 0.0]
    rotation = Rotation.from_rotvec(turn_rad) * Rotation.from_rotvec(tilt_rad)
    position_m = np.array([truth[f"{pose}.{axis}_m"] for axis in "xyz"]) + rotation.apply(shift_m)
    winding = [truth[f"{coil}.{key}"] for key in ("radius_m", "wire_radius_m")]
    counts = [round(truth[f"{coil}.{key}_loops"]) for key in ("axial", "radial")]
    return rotation.apply(coil_field_T(rotation.inv().apply(points_m - position_m), *winding, *counts, 1.0))
