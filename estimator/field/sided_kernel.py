"""Loops with straight sides in machine code, without derivatives or with the first ones; the formulas are those of `field.sided`."""

from __future__ import annotations

from math import sqrt

import numpy as np
from jaxtyping import Float

from estimator.field.machine_code import array_of, machine_code
from estimator.field.quadrature import arcs_of
from estimator.field.straight import MU0_OVER_4PI
from estimator.tensors import Tensor, torch


def sum_of_sided_loops(
    points_m: Float[Tensor, "rows point 3"], loops: Float[Tensor, "rows node 5"], arc_points: int
) -> Float[Tensor, "rows point 3"]:
    """Field per ampere of weighted loops, row by row.

    Args:
        points_m: Points in the coil frame.
        loops: Height, half the distance of the sides along x and along y, corner radius and weight of each loop.
        arc_points: Points along each arc; 0 where corners are sharp.
    """
    field = np.empty(points_m.shape)
    _sum(array_of(points_m), array_of(loops), arcs_of(arc_points), field)
    return torch.from_numpy(field)


def slopes_of_sided_loops(
    points_m: Float[Tensor, "rows point 3"],
    loops: Float[Tensor, "rows node 5"],
    changes: Float[Tensor, "rows node 5 number"],
    arc_points: int,
) -> tuple[Float[Tensor, "rows point 3"], Float[Tensor, "rows point 3 slope"]]:
    """Field per ampere of weighted loops in T/A, and its derivatives along x, y and z, then in some numbers.

    Args:
        points_m, loops, arc_points: As in `sum_of_sided_loops`.
        changes: Derivatives of the loops in these numbers.
    """
    field, slopes = np.zeros(points_m.shape), np.zeros((*points_m.shape, 3 + changes.shape[-1]))
    arrays = (array_of(tensor) for tensor in (points_m, loops, changes))
    _slopes(*arrays, arcs_of(arc_points), field, slopes)
    return torch.from_numpy(field), torch.from_numpy(slopes)


@machine_code
def _wire(along, rho2, half):  # type: ignore[no-untyped-def]
    """`straight.along_wire` of one wire, and the inverse cubes of the distances of its ends."""
    to_start, to_end = along + half, along - half
    a, b = sqrt(to_start * to_start + rho2), sqrt(to_end * to_end + rho2)
    product, inner = a * b, to_start * to_end + rho2
    length = 2.0 * half
    total = length * length * rho2 / (product - inner) if inner < 0.0 else product + inner
    return length * (a + b) / (product * total), 1.0 / (a * a * a), 1.0 / (b * b * b)


@machine_code
def _sum(points, loops, arcs, field):  # type: ignore[no-untyped-def]
    """Fill `field` point by point."""
    for row in range(len(points)):
        for i in range(points.shape[1]):
            x, y, z = points[row, i]
            sum_x, sum_y, sum_z = 0.0, 0.0, 0.0
            for node in range(loops.shape[1]):
                height, half_x, half_y, radius, weight = loops[row, node]
                up = z - height
                up2 = up * up
                along_x, along_y = half_x - radius, half_y - radius
                south, north, east, west = y + half_y, half_y - y, half_x - x, x + half_x
                of_south = _wire(x, south * south + up2, along_x)[0]
                of_north = _wire(x, north * north + up2, along_x)[0]
                of_east = _wire(y, east * east + up2, along_y)[0]
                of_west = _wire(y, west * west + up2, along_y)[0]
                b_x, b_y = up * (of_east - of_west), up * (of_north - of_south)
                b_z = south * of_south + north * of_north + east * of_east + west * of_west
                for k in range(len(arcs)):
                    c, s, share, right, back = arcs[k]
                    away_x, away_y = x - right * along_x - radius * c, y - back * along_y - radius * s
                    r2 = away_x * away_x + away_y * away_y + up2
                    scale = radius * share / (r2 * sqrt(r2))
                    b_x += scale * c * up
                    b_y += scale * s * up
                    b_z -= scale * (s * away_y + c * away_x)
                sum_x += weight * b_x
                sum_y += weight * b_y
                sum_z += weight * b_z
            field[row, i, 0] = MU0_OVER_4PI * sum_x
            field[row, i, 1] = MU0_OVER_4PI * sum_y
            field[row, i, 2] = MU0_OVER_4PI * sum_z


@machine_code
def _slopes(points, loops, changes, arcs, field, slopes):  # type: ignore[no-untyped-def]
    """Fill `field` and `slopes` point by point, from zero."""
    n_numbers = changes.shape[3]
    b, g = np.empty(3), np.empty((3, 6))  # of a loop, and its slopes in x, y, up, half_x, half_y and radius
    for row in range(len(points)):
        for i in range(points.shape[1]):
            for node in range(loops.shape[1]):
                weight = loops[row, node, 4] * MU0_OVER_4PI
                b[:] = 0.0
                g[:] = 0.0
                _sides(points[row, i], loops[row, node], b, g)
                _corners(points[row, i], loops[row, node], arcs, b, g)
                for k in range(3):
                    field[row, i, k] += weight * b[k]
                    for axis in range(3):
                        slopes[row, i, k, axis] += weight * g[k, axis]
                    for n in range(n_numbers):
                        change = changes[row, node, :, n]
                        by_shape = g[k, 3] * change[1] + g[k, 4] * change[2] + g[k, 5] * change[3]
                        slopes[row, i, k, 3 + n] += weight * (by_shape - g[k, 2] * change[0])
                        slopes[row, i, k, 3 + n] += MU0_OVER_4PI * b[k] * change[4]


@machine_code
def _sides(point, loop, b, g):  # type: ignore[no-untyped-def]
    """Add the four straight sides; the first side along each axis lies at its negative end."""
    up = point[2] - loop[0]
    for across in range(2):  # axis from side to side; the wire runs along the other one
        half, other_half = loop[1 + across], loop[2 - across]
        u, t = point[1 - across], point[across]
        wire_half = other_half - loop[3]
        for side in (1.0, -1.0):
            away = half + side * t
            rho2 = away * away + up * up
            w, a3, b3 = _wire(u, rho2, wire_half)
            w_u, w_half = a3 - b3, a3 + b3
            # Homogeneous of degree -2 in all lengths. It only occurs times rho2, so no digits are lost next to the wire's line.
            w_2rho2 = -(2.0 * w + u * w_u + wire_half * w_half) / rho2 if rho2 > 1e-300 else 0.0
            w_away, w_up = away * w_2rho2, up * w_2rho2
            flat = -side  # the wire at the negative end runs so that its field above it points back
            b[across] += flat * up * w
            b[2] += away * w
            for k, factor in ((across, flat * up), (2, away)):
                g[k, 1 - across] += factor * w_u
                g[k, across] += factor * w_away * side
                g[k, 2] += factor * w_up
                g[k, 3 + across] += factor * w_away
                g[k, 4 - across] += factor * w_half
                g[k, 5] -= factor * w_half
            g[across, 2] += flat * w
            g[2, across] += side * w
            g[2, 3 + across] += w


@machine_code
def _corners(point, loop, arcs, b, g):  # type: ignore[no-untyped-def]
    """Add the four arcs."""
    up, radius = point[2] - loop[0], loop[3]
    # At a point of an arc: its field, and slopes in away_x, away_y, up and radius.
    p, by = np.empty(3), np.empty((3, 4))
    for k in range(len(arcs)):
        c, s, share, right, back = arcs[k]
        away_x = point[0] - right * (loop[1] - radius) - radius * c
        away_y = point[1] - back * (loop[2] - radius) - radius * s
        r2 = away_x * away_x + away_y * away_y + up * up
        per_radius = share / (r2 * sqrt(r2))
        scale = radius * per_radius
        p[0], p[1], p[2] = c * up, s * up, -(s * away_y + c * away_x)
        by[:] = 0.0
        by[0, 2], by[1, 2], by[2, 0], by[2, 1] = scale * c, scale * s, -scale * c, -scale * s
        shrink = -3.0 * scale / r2
        for m in range(3):
            b[m] += scale * p[m]
            by[m, 0] += shrink * away_x * p[m]
            by[m, 1] += shrink * away_y * p[m]
            by[m, 2] += shrink * up * p[m]
            by[m, 3] = per_radius * p[m] + (right - c) * by[m, 0] + (back - s) * by[m, 1]
            g[m, 0] += by[m, 0]
            g[m, 1] += by[m, 1]
            g[m, 2] += by[m, 2]
            g[m, 3] -= right * by[m, 0]
            g[m, 4] -= back * by[m, 1]
            g[m, 5] += by[m, 3]
