"""Sums over loops in machine code, for numbers in double precision on the processor that carry no derivatives.

The formulas are those of `field.loop`, which does the same with tensors of any kind. A block of points stays in the fastest cache while all
loops pass, eight points to an instruction where the processor has AVX-512, so a loop takes a fiftieth of the time: as long as in C by hand
(`make bench-kernel`).

All numbers of a block lie in one array, row after row at offsets known to the compiler. In arrays of their own it would have to check that
they do not overlap, gives up for this many, and takes one point after another, seven times as slowly (`docs/decisions/0005`).
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from jaxtyping import Float

from estimator.field.loop import FEWEST_STEPS
from estimator.field.machine_code import array_of, machine_code
from estimator.tensors import Tensor, torch
from estimator.units import MU0_T_M_PER_A

POINTS_AT_ONCE = 32  # in a block
# Where the rows of a block begin. The first ones hold the points.
X, Y, Z, Y2, RHO2, U, S, P2, MEAN, T, PRODUCT, SQUARE, H_SUM, AXIAL_SUM = (
    POINTS_AT_ONCE * k for k in range(14)
)
H, H_Z, H_A, AXIAL, AXIAL_Z, AXIAL_A = (POINTS_AT_ONCE * k for k in range(14, 20))  # of one loop, for slopes
ROWS = 20
# After these, for rings of dipoles: four factors of the ring itself, then four of each pattern.
RING, PATTERNS = POINTS_AT_ONCE * ROWS, POINTS_AT_ONCE * (ROWS + 4)
SMALLEST_RHO2_M2 = 1e-30  # square of the distance to the axis; nearer, a derivative in it has no effect
QUARTER_MU0 = 0.25 * MU0_T_M_PER_A


def sum_of_loops(
    points_m: Float[Tensor, "rows point 3"],
    height_m: Float[Tensor, "rows node"],
    radius_m: Float[Tensor, "rows node"],
    weight: Float[Tensor, "rows node"],
    steps: int,
) -> Float[Tensor, "rows point 3"]:
    """Field per ampere of weighted loops about z, row by row.

    Args:
        points_m: Points in the coil frame.
        height_m, radius_m, weight: Of the loops of every row.
        steps: AGM steps of each loop; at least `FEWEST_STEPS` are taken.
    """
    arrays = [array_of(tensor) for tensor in (points_m, height_m, radius_m, weight)]
    field = np.empty(points_m.shape)
    _sum(*arrays, steps, field)
    return torch.from_numpy(field)


def slopes_of_loops(
    points_m: Float[Tensor, "rows point 3"],
    height_m: Float[Tensor, "rows node"],
    radius_m: Float[Tensor, "rows node"],
    steps: int,
) -> Float[Tensor, "2 rows 3 node point"]:
    """The factors h and axial of each loop's field at each point: each with its derivatives along z and in the radius.

    Args:
        points_m, height_m, radius_m, steps: As in `sum_of_loops`.
    """
    arrays = [array_of(tensor) for tensor in (points_m, height_m, radius_m)]
    n_rows, n_nodes = height_m.shape
    factors = np.empty((2, n_rows, 3, n_nodes, points_m.shape[1]))
    _slopes(*arrays, steps, factors)
    return torch.from_numpy(factors)


def field_and_slopes(
    points_m: Float[Tensor, "rows point 3"], sums: Float[Tensor, "2 rows 2 point"]
) -> tuple[Float[Tensor, "rows point 3"], Float[Tensor, "rows point 3 3"]]:
    """Field of loops about z and its derivatives in the points, of the factors h and axial and their derivatives along z.

    Args:
        points_m: Points in the coil frame.
        sums: The factors at each point, summed over loops, each with its derivative along z.
    """
    field, slopes = np.empty(points_m.shape), np.empty((*points_m.shape, 3))
    _field_and_slopes(array_of(points_m), array_of(sums), field, slopes)
    return torch.from_numpy(field), torch.from_numpy(slopes)


def sums_of_rings(
    points_m: Float[Tensor, "rows point 3"],
    height_m: Float[Tensor, " ring"],
    radius_m: Float[Tensor, " ring"],
    step_m: Float[Tensor, " ring"],
    axial_A: Float[Tensor, "pattern ring"],
    radial_A: Float[Tensor, "pattern ring"],
    steps: int,
) -> Float[Tensor, "2 rows pattern 2 point"]:
    """The factors h and axial of rings of dipoles, summed for each pattern, each with its derivative along z.

    Args:
        points_m: Points in the coil frame.
        height_m, radius_m, step_m: Of each ring, and how far the loops lie apart whose difference stands for it.
        axial_A, radial_A: Currents in these loops for a ring magnetised along the axis and outwards.
        steps: AGM steps of each loop.
    """
    arrays = [array_of(tensor) for tensor in (points_m, height_m, radius_m, step_m, axial_A, radial_A)]
    sums = np.empty((2, len(points_m), len(axial_A), 2, points_m.shape[1]))
    _rings(*arrays, steps, sums)
    return torch.from_numpy(sums)


@machine_code
def _fill(block, points, start, size):  # type: ignore[no-untyped-def]
    """Put points into a block; the last one fills it up."""
    for i in range(POINTS_AT_ONCE):
        x, y, z = points[start + min(i, size - 1)]
        block[X + i], block[Y + i], block[Z + i] = x, y, z
        block[Y2 + i] = y * y
        block[RHO2 + i] = x * x + y * y


@machine_code
def _means(block, height, radius, steps):  # type: ignore[no-untyped-def]
    """What `loop._means` returns, for a block of points."""
    radius2 = radius * radius
    for i in range(POINTS_AT_ONCE):
        x, rho2 = block[X + i], block[RHO2 + i]
        above = block[Z + i] - height
        z2 = above * above
        u = (radius - x) * (radius + x) - block[Y2 + i] + z2
        s = radius2 + rho2 + z2
        p2 = u * u + 4.0 * rho2 * z2
        product = sqrt(p2)
        mean2 = 0.5 * (s + product)
        mean = sqrt(mean2)
        t = radius2 / mean2
        square = t / 16.0
        scale = 32.0
        for _ in range(FEWEST_STEPS):  # a number known to the compiler, so that nothing leaves the registers
            geometric = sqrt(product)
            product = mean * geometric
            mean = 0.5 * (mean + geometric)
            c = square / mean
            square = rho2 * c * c
            t += scale * square
            scale *= 2.0
        block[U + i], block[S + i], block[P2 + i] = u, s, p2
        block[MEAN + i], block[T + i], block[PRODUCT + i], block[SQUARE + i] = mean, t, product, square
    scale = 32.0 * 2.0**FEWEST_STEPS
    for _ in range(FEWEST_STEPS, steps):
        for i in range(POINTS_AT_ONCE):
            geometric = sqrt(block[PRODUCT + i])
            block[PRODUCT + i] = block[MEAN + i] * geometric
            mean = 0.5 * (block[MEAN + i] + geometric)
            c = block[SQUARE + i] / mean
            square = block[RHO2 + i] * c * c
            block[MEAN + i], block[SQUARE + i] = mean, square
            block[T + i] += scale * square
        scale *= 2.0


@machine_code
def _sum(points, heights, radii, weights, steps, field):  # type: ignore[no-untyped-def]
    """Fill `field` row by row, a block of points at a time."""
    block = np.empty(ROWS * POINTS_AT_ONCE)
    n_points = points.shape[1]
    for row in range(len(points)):
        for start in range(0, n_points, POINTS_AT_ONCE):
            size = min(POINTS_AT_ONCE, n_points - start)
            _fill(block, points[row], start, size)
            block[H_SUM : H_SUM + POINTS_AT_ONCE] = 0.0
            block[AXIAL_SUM : AXIAL_SUM + POINTS_AT_ONCE] = 0.0
            for node in range(heights.shape[1]):
                height, radius, weight = heights[row, node], radii[row, node], weights[row, node]
                _means(block, height, radius, steps)
                radius2 = radius * radius
                for i in range(POINTS_AT_ONCE):
                    u, t, above = block[U + i], block[T + i], block[Z + i] - height
                    common = weight * QUARTER_MU0 / (block[MEAN + i] * block[P2 + i])
                    block[H_SUM + i] += (4.0 * radius2 - block[S + i] * t) * common * above
                    v = 2.0 * above * above - u
                    block[AXIAL_SUM + i] += (2.0 * radius2 * u + block[RHO2 + i] * t * v) * common
            for i in range(size):
                field[row, start + i, 0] = block[X + i] * block[H_SUM + i]
                field[row, start + i, 1] = block[Y + i] * block[H_SUM + i]
                field[row, start + i, 2] = block[AXIAL_SUM + i]


@machine_code
def _slopes(points, heights, radii, steps, factors):  # type: ignore[no-untyped-def]
    """Fill `factors` as `loop.loop_derivatives` has them, and with the derivatives in the radius."""
    block = np.empty(ROWS * POINTS_AT_ONCE)
    n_points = points.shape[1]
    for row in range(len(points)):
        for start in range(0, n_points, POINTS_AT_ONCE):
            size = min(POINTS_AT_ONCE, n_points - start)
            _fill(block, points[row], start, size)
            for node in range(heights.shape[1]):
                height, radius = heights[row, node], radii[row, node]
                _means(block, height, radius, steps)
                _slopes_of_one(block, height, radius)
                for i in range(size):
                    factors[0, row, 0, node, start + i] = block[H + i]
                    factors[0, row, 1, node, start + i] = block[H_Z + i]
                    factors[0, row, 2, node, start + i] = block[H_A + i]
                    factors[1, row, 0, node, start + i] = block[AXIAL + i]
                    factors[1, row, 1, node, start + i] = block[AXIAL_Z + i]
                    factors[1, row, 2, node, start + i] = block[AXIAL_A + i]


@machine_code
def _slopes_of_one(block, height, radius):  # type: ignore[no-untyped-def]
    """Factors of one loop and their derivatives, for a block of points with its means."""
    radius2 = radius * radius
    for i in range(POINTS_AT_ONCE):
        above, u, s, t, q = block[Z + i] - height, block[U + i], block[S + i], block[T + i], block[RHO2 + i]
        v, inverse = 2.0 * above * above - u, 1.0 / block[P2 + i]
        qt = q * t
        common = QUARTER_MU0 / block[MEAN + i] * inverse
        bracket = 4.0 * radius2 - s * t
        both = 2.0 * radius2 * u
        h, axial = bracket * common * above, (both + qt * v) * common
        whole = (both + v * s) * inverse
        shared = (both * s + 4.0 * v * radius2 * q) * inverse
        along_q = 0.25 * ((2.0 * qt + bracket) * whole + v * t) - 0.5 * shared + qt - 2.0 * radius2
        along_z2 = 0.5 * qt * whole - 0.5 * shared + 2.0 * radius2 + qt
        h_z = 2.0 * (common * along_q - 2.0 * axial * v * inverse)
        axial_z = 2.0 * above * (common * along_z2 - axial * (2.0 * u + 4.0 * q) * inverse)
        block[H + i], block[H_Z + i] = h, h_z
        block[AXIAL + i], block[AXIAL_Z + i] = axial, axial_z
        # h and axial are homogeneous of degree -2 and -1 in all lengths, and obey the field laws.
        block[H_A + i] = (axial_z - above * h_z) / radius
        block[AXIAL_A + i] = -(axial + q * h_z + above * axial_z) / radius


@machine_code
def _field_and_slopes(points, sums, field, slopes):  # type: ignore[no-untyped-def]
    """Fill `field` and `slopes`."""
    for row in range(points.shape[0]):
        for i in range(points.shape[1]):
            x, y = points[row, i, 0], points[row, i, 1]
            h, h_z = sums[0, row, 0, i], sums[0, row, 1, i]
            axial, axial_z = sums[1, row, 0, i], sums[1, row, 1, i]
            # div B = 0 gives the derivative of h in rho^2, curl B = 0 that of axial.
            bent = -2.0 * (h + 0.5 * axial_z) / max(x * x + y * y, SMALLEST_RHO2_M2)
            field[row, i, 0], field[row, i, 1], field[row, i, 2] = x * h, y * h, axial
            slopes[row, i, 0, 0], slopes[row, i, 1, 1] = bent * x * x + h, bent * y * y + h
            slopes[row, i, 0, 1] = slopes[row, i, 1, 0] = bent * x * y
            slopes[row, i, 0, 2] = slopes[row, i, 2, 0] = h_z * x
            slopes[row, i, 1, 2] = slopes[row, i, 2, 1] = h_z * y
            slopes[row, i, 2, 2] = axial_z


@machine_code
def _rings(points, heights, radii, moves, axial, radial, steps, sums):  # type: ignore[no-untyped-def]
    """Fill `sums`. Differences come first: sums of many loops would round by as much as their difference is worth."""
    n_points, n_patterns = points.shape[1], len(axial)
    block = np.empty((ROWS + 4 + 4 * n_patterns) * POINTS_AT_ONCE)
    for row in range(len(points)):
        for start in range(0, n_points, POINTS_AT_ONCE):
            size = min(POINTS_AT_ONCE, n_points - start)
            _fill(block, points[row], start, size)
            block[PATTERNS:] = 0.0
            for k in range(len(heights)):
                height, radius, step = heights[k], radii[k], moves[k]
                _means(block, height, radius, steps)
                _slopes_of_one(block, height, radius)
                for i in range(POINTS_AT_ONCE):
                    block[RING + i], block[RING + POINTS_AT_ONCE + i] = block[H + i], block[H_Z + i]
                    block[RING + 2 * POINTS_AT_ONCE + i] = block[AXIAL + i]
                    block[RING + 3 * POINTS_AT_ONCE + i] = block[AXIAL_Z + i]
                _means(block, height, radius + step, steps)
                _slopes_of_one(block, height, radius + step)
                for pattern in range(n_patterns):
                    _add_difference(block, axial[pattern, k], PATTERNS + 4 * POINTS_AT_ONCE * pattern)
                _means(block, height + step, radius, steps)
                _slopes_of_one(block, height + step, radius)
                for pattern in range(n_patterns):
                    _add_difference(block, -radial[pattern, k], PATTERNS + 4 * POINTS_AT_ONCE * pattern)
            for pattern in range(n_patterns):
                first = PATTERNS + 4 * POINTS_AT_ONCE * pattern
                for i in range(size):
                    sums[0, row, pattern, 0, start + i] = block[first + i]
                    sums[0, row, pattern, 1, start + i] = block[first + POINTS_AT_ONCE + i]
                    sums[1, row, pattern, 0, start + i] = block[first + 2 * POINTS_AT_ONCE + i]
                    sums[1, row, pattern, 1, start + i] = block[first + 3 * POINTS_AT_ONCE + i]


@machine_code
def _add_difference(block, current, first):  # type: ignore[no-untyped-def]
    """Add a loop's factors less those of its ring, times a current, to those of a pattern."""
    for i in range(POINTS_AT_ONCE):
        block[first + i] += current * (block[H + i] - block[RING + i])
        block[first + POINTS_AT_ONCE + i] += current * (block[H_Z + i] - block[RING + POINTS_AT_ONCE + i])
        block[first + 2 * POINTS_AT_ONCE + i] += current * (
            block[AXIAL + i] - block[RING + 2 * POINTS_AT_ONCE + i]
        )
        block[first + 3 * POINTS_AT_ONCE + i] += current * (
            block[AXIAL_Z + i] - block[RING + 3 * POINTS_AT_ONCE + i]
        )
