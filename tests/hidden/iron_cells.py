"""Iron bodies by the moment method: cubes of uniform polarisation with magpylib's field, and a curve of magnetisation in every cube.

Nothing here is shared with the estimator: cells instead of slices, all three components in each, the field of cuboids instead of loops,
a fixed-point iteration with one factorisation for all currents instead of Newton's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import magpylib
import numpy as np
from scipy.linalg import lu_factor, lu_solve
from scipy.spatial.transform import Rotation

from tests.hidden.protocols import Array

MOST_STEPS, TOLERANCE = 400, 1e-6
STIFF = 0.05  # reluctance that the iteration takes to both sides; from zero it approaches a curve from below
Curve = Callable[
    [Array], Array
]  # polarisation in T -> mu0 H over polarisation, the inverse of the secant susceptibility


@dataclass(frozen=True)
class IronRod:
    """A round rod of cubes, about the z axis of a frame of its own.

    Attributes:
        radius_m, length_m, front_m: Of the rod; the front face is the upper one.
        across: Cubes across its diameter.
        rotation, position_m: world_from_rod.
    """

    radius_m: float
    length_m: float
    front_m: float
    across: int
    rotation: Rotation
    position_m: Array

    @property
    def grid(self) -> Array:
        """Whole-number places of the cubes."""
        middle = 0.5 * (self.across - 1)
        x, y = (v.ravel() - middle for v in np.meshgrid(np.arange(self.across), np.arange(self.across)))
        is_in = x**2 + y**2 < (0.5 * self.across) ** 2
        layer = np.column_stack((x[is_in], y[is_in]))
        n_layers = round(self.length_m / self._width_m(len(layer)))
        return np.concatenate(
            [np.column_stack((layer, np.full(len(layer), float(k)))) for k in range(n_layers)]
        )

    def _width_m(self, n_in_layer: int) -> float:
        return float(self.radius_m * np.sqrt(np.pi / n_in_layer))

    @property
    def edges_m(self) -> Array:
        """Of one cell; the cross-section of all is that of the rod, and so is the length."""
        grid = self.grid
        n_layers = int(grid[:, 2].max()) + 1
        width_m = self._width_m(len(grid) // n_layers)
        return np.array([width_m, width_m, self.length_m / n_layers])

    @property
    def centres_m(self) -> Array:
        """In the rod's frame."""
        grid, edges_m = self.grid, self.edges_m
        places: Array = grid * edges_m
        places[:, 2] = self.front_m - places[:, 2] - 0.5 * edges_m[2]
        return places


def field_per_T(rod: IronRod, points_m: Array) -> Array:
    """Flux density of each cell polarised along each axis of the rod: point, field xyz in the world, cell, polarisation xyz."""
    centres_m = rod.centres_m
    local_m = rod.rotation.inv().apply(points_m - rod.position_m)
    apart_m = local_m[:, None, :] - centres_m
    field = _of_cuboid(rod.edges_m, apart_m.reshape(-1, 3)).reshape(len(points_m), len(centres_m), 3, 3)
    return np.einsum("wl,pclj->pwcj", rod.rotation.as_matrix(), field)


def _of_cuboid(edges_m: Array, at_m: Array) -> Array:
    """Field of one cuboid about the origin: point, field xyz, polarisation xyz."""
    columns = [
        magpylib.magnet.Cuboid(polarization=tuple(axis), dimension=tuple(edges_m)).getB(at_m)
        for axis in np.eye(3)
    ]
    return np.stack(columns, axis=-1).reshape(len(at_m), 3, 3)


def _inside(rod: IronRod) -> Array:
    """mu0 H in the middle of each cell by the polarisation of each: 3 n by 3 n, averaged over eight points of the cell."""
    grid = rod.grid
    steps = (grid[:, None, :] - grid).reshape(-1, 3)
    distinct, which = np.unique(steps, axis=0, return_inverse=True)
    edges_m = rod.edges_m
    corner = 0.5 / np.sqrt(3.0)
    total = np.zeros((len(distinct), 3, 3))
    for sign in np.array(np.meshgrid((-1, 1), (-1, 1), (-1, 1))).reshape(3, -1).T:
        at_m = (distinct * [1, 1, -1] + corner * sign) * edges_m
        total += _of_cuboid(edges_m, at_m) / 8.0
    total[(distinct == 0).all(1)] -= np.eye(3)  # mu0 H = B - J in the cell itself
    n = len(grid)
    return total[which.ravel()].reshape(n, n, 3, 3).transpose(0, 2, 1, 3).reshape(3 * n, 3 * n)


def polarisations_T(rods: list[IronRod], applied_T: list[Array], reluctance: Curve) -> list[Array]:
    """Polarisation of every cell in its rod's frame, for several settings of the currents.

    Args:
        rods: Bodies that answer the field and each other.
        applied_T: Per rod mu0 H of the coils at its cells in the world frame: setting, cell, xyz.
        reluctance: mu0 H over polarisation, given the polarisation's size.
    """
    sizes = [3 * len(rod.grid) for rod in rods]
    ends = np.cumsum([0, *sizes])
    matrix = np.zeros((ends[-1], ends[-1]))
    for i, rod in enumerate(rods):
        at_m = rod.rotation.apply(rod.centres_m) + rod.position_m
        for k, source in enumerate(rods):
            if i == k:
                block = -_inside(rod)
            else:
                field = field_per_T(source, at_m)
                local = np.einsum("wl,pwcj->plcj", rod.rotation.as_matrix(), field)
                block = -local.reshape(sizes[i], sizes[k])
            matrix[ends[i] : ends[i + 1], ends[k] : ends[k + 1]] = block
    drive = np.concatenate(
        [(b @ rod.rotation.as_matrix()).reshape(len(b), -1) for rod, b in zip(rods, applied_T, strict=True)],
        axis=1,
    ).T
    size = np.zeros((len(drive) // 3, drive.shape[1]))
    polarisation = np.zeros_like(drive)
    factored = lu_factor(matrix + STIFF * np.eye(len(matrix)))
    for _ in range(MOST_STEPS):
        now = np.repeat(reluctance(size), 3, axis=0)
        moved = lu_solve(factored, drive + (STIFF - now) * polarisation)
        step = np.abs(moved - polarisation).max() / np.abs(moved).max()
        polarisation = moved
        size = np.linalg.norm(polarisation.reshape(-1, 3, polarisation.shape[1]), axis=1)
        if step < TOLERANCE:
            return [polarisation[a:b].T.reshape(drive.shape[1], -1, 3) for a, b in pairwise(ends)]
    raise RuntimeError(f"polarisation must settle; still changing by {step:g}")
