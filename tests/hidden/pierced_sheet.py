"""A loop's field through a round opening in a perfect sheet of iron on its axis: the dual integral equations, by quadrature in NumPy.

The potential that the opening adds is `integral of g(t) Im [rho^2 + (|z| - i t)^2]^(-1/2) dt` from 0 to its radius, with
`g(t) = 2/pi integral of rho B(rho) (t^2 - rho^2)^(-1/2) drho` from 0 to t, B the source's own field across the opening (Sneddon, Mixed
Boundary Value Problems in Potential Theory, 1966, section 3.3). Exact for a source that is round about the opening's axis; points in its plane need closed forms.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.polynomial import Chebyshev
from numpy.polynomial.legendre import leggauss

NODES, ANGLES = 800, 40
DEGREE = 80  # of the source's field across the opening, far from whose plane its wires are: exact to rounding


def pierced_T(
    source_T: Callable[[np.ndarray], np.ndarray], height_m: float, radius_m: float, points_m: np.ndarray
) -> np.ndarray:
    """Field at points of a source below the plane z = height, which is iron but for an opening about the axis."""
    is_behind = points_m[:, 2] > height_m
    mirrored_m = points_m * [1.0, 1.0, -1.0] + [0.0, 0.0, 2.0 * height_m]
    image_T = source_T(mirrored_m) * [-1.0, -1.0, 1.0]
    total = np.where(is_behind[:, None], 0.0, source_T(points_m) + image_T)
    nodes, weights = leggauss(NODES)
    t, dt = 0.5 * radius_m * (nodes + 1.0), 0.5 * radius_m * weights
    nodes, weights = leggauss(ANGLES)
    angle, d_angle = 0.25 * np.pi * (nodes + 1.0), 0.25 * np.pi * weights
    rho = t[:, None] * np.sin(angle)

    def across_T(rho_m: np.ndarray) -> np.ndarray:
        on_plane_m = np.column_stack((rho_m, np.zeros_like(rho_m), np.full_like(rho_m, height_m)))
        return np.asarray(source_T(on_plane_m)[:, 2])

    smooth_T = Chebyshev.interpolate(across_T, DEGREE, domain=[0.0, radius_m])
    density = 2.0 / np.pi * (rho * smooth_T(rho)) @ d_angle
    beside = points_m * [1.0, 1.0, 0.0]
    u = np.abs(points_m[:, 2] - height_m)[:, None] - 1j * t
    root = np.sqrt((beside**2).sum(1)[:, None] + u**2) ** 3
    slope_z = -(np.imag(u / root) * density) @ dt
    slope_rho = -(np.imag(1.0 / root) * density) @ dt  # per distance from the axis
    side = np.where(is_behind, 1.0, -1.0)
    total[:, 2] -= side * slope_z
    return total - slope_rho[:, None] * beside
