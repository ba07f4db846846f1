"""A winding whose filaments hold flux and screen: a hollow magnet of magpylib, and dipoles against the field at their places."""

from __future__ import annotations

import magpylib
import numpy as np

from tests.hidden.coil import MU0, CoilField, Winding
from tests.hidden.protocols import Array

CELLS, ANGLES = (6, 24), 48


def trapped_T(winding: Winding, axial_T: float, points_m: Array) -> Array:
    """Field of a winding that is magnetised along its axis, in its frame."""
    inner_m = winding.radius_m - winding.radial_pitch_m * winding.radial_loops
    magnet = magpylib.magnet.CylinderSegment(
        polarization=(0.0, 0.0, axial_T),
        dimension=(inner_m, winding.radius_m, winding.length_m, 0.0, 360.0),
        position=(0.0, 0.0, -0.5 * winding.length_m),
    )
    return np.asarray(magnet.getB(points_m))


def screened_T(winding: Winding, susceptibility: float, source: CoilField, points_m: Array) -> Array:
    """Field of a winding that turns a share of a foreign field against it, in its frame, per ampere in the source."""
    n_radial, n_axial = CELLS
    inner_m = winding.radius_m - winding.radial_pitch_m * winding.radial_loops
    width_m, height_m = (winding.radius_m - inner_m) / n_radial, winding.length_m / n_axial
    turn = 2.0 * np.pi * (np.arange(ANGLES) + 0.5) / ANGLES
    rho, z, phi = (
        grid.ravel()
        for grid in np.meshgrid(
            inner_m + width_m * (np.arange(n_radial) + 0.5), -height_m * (np.arange(n_axial) + 0.5), turn
        )
    )
    at_m = np.column_stack((rho * np.cos(phi), rho * np.sin(phi), z))
    volume_m3 = width_m * height_m * 2.0 * np.pi * rho / ANGLES
    moment = -susceptibility * source(at_m) * volume_m3[:, None] / MU0
    total = np.zeros_like(points_m)
    for i, point_m in enumerate(points_m):
        arm = point_m - at_m
        r2 = (arm**2).sum(1, keepdims=True)
        along = (arm * moment).sum(1, keepdims=True)
        total[i] = MU0 / (4.0 * np.pi) * ((3.0 * arm * along - r2 * moment) * r2**-2.5).sum(0)
    return total
