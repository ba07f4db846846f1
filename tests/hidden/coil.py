"""Field of a winding through magpylib's loops, in the coil frame, per ampere.

A winding is a set of loops on a grid of heights and radii. Where the readings lie outside, far fewer loops than it has give the same
field: those at the nodes of the Gauss rule of its heights and radii (Lanczos on the loops' own places and weights, so that uneven
windings work too). The tests hold the shortened sum against the full one to 1e-7.

Frame: origin on the front face, +z out of the coil, loops at -2 R_w N_a < z < 0 (Osinde et al., eq 9-10).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import magpylib
import numpy as np
from magpylib.core import current_circle_Hfield, current_polyline_Hfield

from tests.hidden.protocols import Array

MU0 = float(magpylib.mu_0)
NODES = 14  # per direction: 1e-7 of the field from 8 mm off the face
CoilField = Callable[[Array], Array]  # points in the coil frame -> tesla per ampere


@dataclass(frozen=True)
class Winding:
    """The truth of a winding: the paper's four numbers, with the pitches apart from the wire's diameter.

    `turn_factor` multiplies the field; it is 1 but in derivatives, where it stands for a count that is not whole.
    """

    radius_m: float
    wire_radius_m: float
    axial_loops: int
    radial_loops: int
    axial_pitch_factor: float = 1.0
    radial_pitch_factor: float = 1.0
    turn_factor: float = 1.0

    @property
    def axial_pitch_m(self) -> float:
        """Distance of neighbouring turns along the axis."""
        return 2.0 * self.wire_radius_m * self.axial_pitch_factor

    @property
    def radial_pitch_m(self) -> float:
        """Distance of neighbouring layers."""
        return 2.0 * self.wire_radius_m * self.radial_pitch_factor

    @property
    def length_m(self) -> float:
        """From the front face to the back."""
        return self.axial_pitch_m * self.axial_loops

    @property
    def heights_m(self) -> Array:
        """Of the turns, from front to back."""
        return np.asarray(-self.axial_pitch_m * (np.arange(self.axial_loops) + 0.5))

    @property
    def radii_m(self) -> Array:
        """Of the layers, from the outermost in."""
        return np.asarray(self.radius_m - self.radial_pitch_m * (np.arange(self.radial_loops) + 0.5))


@dataclass(frozen=True)
class Block:
    """Loops at every pair of a height and a radius; a loop's strength is the product of the two weights."""

    heights_m: Array
    turns: Array
    radii_m: Array
    layers: Array

    def reduced(self, nodes: int = NODES) -> Block:
        """Few loops with the same field outside."""
        return Block(*_gauss(self.heights_m, self.turns, nodes), *_gauss(self.radii_m, self.layers, nodes))

    def loops(self) -> tuple[Array, Array, Array]:
        """Height, radius and weight of each loop."""
        height, radius = np.meshgrid(self.heights_m, self.radii_m, indexing="ij")
        return height.ravel(), radius.ravel(), np.outer(self.turns, self.layers).ravel()


def blocks_of(winding: Winding) -> tuple[Block, ...]:
    """The undisturbed winding: every loop carries the whole current."""
    turns = np.full(winding.axial_loops, winding.turn_factor)
    return (Block(winding.heights_m, turns, winding.radii_m, np.ones(winding.radial_loops)),)


def circular_field(blocks: Sequence[Block], nodes: int = NODES) -> CoilField:
    """Field per ampere of circular loops; `nodes` beyond the number of loops sums every loop.

    The last few answers are remembered: most flaws of a session leave the places of its readings in the coil's frame as they are.
    """
    parts = [block.reduced(nodes).loops() for block in blocks]
    height, radius, weight = (np.concatenate([part[i] for part in parts]) for i in range(3))

    @lru_cache(maxsize=4)
    def field_at(content: bytes) -> Array:
        points_m = np.frombuffer(content).reshape(-1, 3)
        places, place = np.unique(points_m, axis=0, return_inverse=True)
        return _sum_of_loops(places, height, radius, weight)[place.ravel()]

    return lambda points_m: field_at(np.ascontiguousarray(points_m, dtype=float).tobytes()).copy()


def polyline_field(points_m: Array, corners_m: Array) -> Array:
    """Field per ampere of straight conductors from corner to corner."""
    start, end = corners_m[:-1], corners_m[1:]
    n, k = len(points_m), len(start)
    at, first, last = np.repeat(points_m, k, axis=0), np.tile(start, (n, 1)), np.tile(end, (n, 1))
    field_A_per_m = np.asarray(current_polyline_Hfield(at, first, last, np.ones(n * k)))
    return np.asarray(MU0 * field_A_per_m.reshape(n, k, 3).sum(axis=1))


def closed_curve_field(points_m: Array, curve_m: Array, tangent_m: Array) -> Array:
    """Biot-Savart over smooth closed curves by the trapezoid rule, which converges exponentially there.

    Args:
        points_m: Where the field is wanted, point by xyz.
        curve_m, tangent_m: Curve by step by xyz: places at equal steps of a parameter over one period, and the derivative times the
            step, times the current where that is not 1 A.
    """
    total = np.zeros_like(points_m)
    for curve, tangent in zip(curve_m, tangent_m, strict=True):
        arm = points_m[:, None, :] - curve
        total += np.einsum("psi,ps->pi", np.cross(tangent, arm), 1.0 / np.linalg.norm(arm, axis=2) ** 3)
    return np.asarray(MU0 / (4.0 * np.pi) * total)


def _sum_of_loops(points_m: Array, height_m: Array, radius_m: Array, weight: Array) -> Array:
    rho_m, h_rho, h_z = loop_components(points_m, height_m, radius_m)
    b_rho, b_z = MU0 * (h_rho @ weight), MU0 * (h_z @ weight)
    unit = points_m[:, :2] / np.where(rho_m > 0.0, rho_m, 1.0)[:, None]
    return np.column_stack([unit * b_rho[:, None], b_z])


def loop_components(points_m: Array, height_m: Array, radius_m: Array) -> tuple[Array, Array, Array]:
    """Distance of each point from the axis, and radial and axial field strength per ampere, point by loop."""
    n, k = len(points_m), len(height_m)
    rho_m = np.hypot(points_m[:, 0], points_m[:, 1])
    above_m = points_m[:, 2:3] - height_m
    h = current_circle_Hfield(np.tile(radius_m, n), np.repeat(rho_m, k), above_m.ravel(), np.ones(n * k))
    return rho_m, np.asarray(h[0]).reshape(n, k), np.asarray(h[2]).reshape(n, k)


def _gauss(places_m: Array, weights: Array, nodes: int) -> tuple[Array, Array]:
    """Gauss rule of a discrete measure: Lanczos with the places as a diagonal matrix and the roots of the weights as start."""
    places_m, weights = places_m[weights > 0.0], weights[weights > 0.0]
    if nodes >= len(places_m):
        return places_m, weights
    total = weights.sum()
    middle, half = 0.5 * (places_m.max() + places_m.min()), 0.5 * np.ptp(places_m)
    x = (places_m - middle) / half
    basis = [np.sqrt(weights / total)]
    for _ in range(nodes - 1):
        v = x * basis[-1]
        for _ in range(2):  # once is not enough to keep the basis orthogonal
            for u in basis:
                v = v - (u @ v) * u
        basis.append(v / np.linalg.norm(v))
    q = np.array(basis)
    node, vector = np.linalg.eigh((q * x) @ q.T)
    return middle + half * node, total * vector[0] ** 2
