"""Sums over loops in machine code, for numbers in double precision on the processor that carry no derivatives.

The formulas are those of `field.loop`, which does the same with tensors of any kind. Point after point stays in the cache, so a loop takes
a tenth of the time. numba translates the code when it is first called on a machine and keeps it on disk (`docs/decisions/0005`).
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from math import sqrt
from typing import Any

import numba
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd import forward_ad

from estimator.units import MU0_T_M_PER_A

POINTS_AT_ONCE = 64  # whose intermediate numbers stay in the fastest cache
QUARTER_MU0 = 0.25 * MU0_T_M_PER_A


def is_plain(*tensors: Tensor) -> bool:
    """Whether tensors are numbers that the kernels take: on the processor, in double precision, and without derivatives.

    Examples:
        >>> one = torch.ones(3, dtype=torch.float64)
        >>> is_plain(one), is_plain(one.float()), is_plain(one.clone().requires_grad_())
        (True, False, False)
    """
    return all(
        tensor.device.type == "cpu"
        and tensor.dtype == torch.float64
        and not (tensor.requires_grad and torch.is_grad_enabled())
        and not torch._C._functorch.is_functorch_wrapped_tensor(tensor)
        and forward_ad.unpack_dual(tensor).tangent is None
        for tensor in tensors
    )


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
        steps: AGM steps of each loop.
    """
    arrays = [_array(tensor) for tensor in (points_m, height_m, radius_m, weight)]
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
    arrays = [_array(tensor) for tensor in (points_m, height_m, radius_m)]
    n_rows, n_nodes = height_m.shape
    factors = np.empty((2, n_rows, 3, n_nodes, points_m.shape[1]))
    _slopes(*arrays, steps, factors)
    return torch.from_numpy(factors)


def _array(tensor: Tensor) -> np.ndarray:
    return tensor.detach().contiguous().numpy()


def machine_code(function: Callable[..., None]) -> Any:
    """Machine code of a function, kept on disk where a folder for it can be written."""
    plain = inspect.unwrap(function)  # without the checks of shapes that tests put around every function
    settings: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
    try:
        return numba.njit(cache=True, **settings)(plain)
    except RuntimeError:  # neither the package's folder nor the user's can be written
        return numba.njit(**settings)(plain)


@machine_code
def _means(  # type: ignore[no-untyped-def]
    x, y2, z, rho2, height, radius, steps, u, s, p2, mean, t, product, square
):
    """What `loop._means` returns, for a block of points; the last two arrays are its own."""
    radius2 = radius * radius
    for i in range(POINTS_AT_ONCE):
        above = z[i] - height
        z2 = above * above
        u[i] = (radius - x[i]) * (radius + x[i]) - y2[i] + z2
        s[i] = radius2 + rho2[i] + z2
        p2[i] = u[i] * u[i] + 4.0 * rho2[i] * z2
        product[i] = sqrt(p2[i])
        mean2 = 0.5 * (s[i] + product[i])
        mean[i] = sqrt(mean2)
        t[i] = radius2 / mean2
        square[i] = t[i] / 16.0
    scale = 32.0
    for _ in range(steps):
        for i in range(POINTS_AT_ONCE):
            geometric = sqrt(product[i])
            product[i] = mean[i] * geometric
            mean[i] = 0.5 * (mean[i] + geometric)
            c = square[i] / mean[i]
            square[i] = rho2[i] * c * c
            t[i] += scale * square[i]
        scale *= 2.0


@machine_code
def _sum(points, heights, radii, weights, steps, field):  # type: ignore[no-untyped-def]
    """Fill `field` row by row, a block of points at a time; the last point fills up the last block."""
    x, y, z, y2, rho2, u, s, p2, mean, t, product, square, h_sum, axial_sum = np.empty((14, POINTS_AT_ONCE))
    n_points = points.shape[1]
    for row in range(len(points)):
        for start in range(0, n_points, POINTS_AT_ONCE):
            size = min(POINTS_AT_ONCE, n_points - start)
            for i in range(POINTS_AT_ONCE):
                x[i], y[i], z[i] = points[row, start + min(i, size - 1)]
                y2[i] = y[i] * y[i]
                rho2[i] = x[i] * x[i] + y2[i]
            h_sum[:] = 0.0
            axial_sum[:] = 0.0
            for node in range(heights.shape[1]):
                height, radius, weight = heights[row, node], radii[row, node], weights[row, node]
                _means(x, y2, z, rho2, height, radius, steps, u, s, p2, mean, t, product, square)
                radius2 = radius * radius
                for i in range(POINTS_AT_ONCE):
                    above = z[i] - height
                    common = weight * QUARTER_MU0 / (mean[i] * p2[i])
                    h_sum[i] += (4.0 * radius2 - s[i] * t[i]) * common * above
                    v = 2.0 * above * above - u[i]
                    axial_sum[i] += (2.0 * radius2 * u[i] + rho2[i] * t[i] * v) * common
            for i in range(size):
                field[row, start + i, 0] = x[i] * h_sum[i]
                field[row, start + i, 1] = y[i] * h_sum[i]
                field[row, start + i, 2] = axial_sum[i]


@machine_code
def _slopes(points, heights, radii, steps, factors):  # type: ignore[no-untyped-def]
    """Fill `factors` as `loop.loop_derivatives` has them, and with the derivatives in the radius."""
    x, y2, z, rho2, u, s, p2, mean, t, product, square = np.empty((11, POINTS_AT_ONCE))
    n_points = points.shape[1]
    for row in range(len(points)):
        for start in range(0, n_points, POINTS_AT_ONCE):
            size = min(POINTS_AT_ONCE, n_points - start)
            for i in range(POINTS_AT_ONCE):
                x[i], y, z[i] = points[row, start + min(i, size - 1)]
                y2[i] = y * y
                rho2[i] = x[i] * x[i] + y2[i]
            for node in range(heights.shape[1]):
                height, radius = heights[row, node], radii[row, node]
                _means(x, y2, z, rho2, height, radius, steps, u, s, p2, mean, t, product, square)
                radius2 = radius * radius
                for i in range(size):
                    above = z[i] - height
                    q, v, inverse = rho2[i], 2.0 * above * above - u[i], 1.0 / p2[i]
                    qt = q * t[i]
                    common = QUARTER_MU0 / mean[i] * inverse
                    bracket = 4.0 * radius2 - s[i] * t[i]
                    both = 2.0 * radius2 * u[i]
                    h, axial = bracket * common * above, (both + qt * v) * common
                    whole = (both + v * s[i]) * inverse
                    shared = (both * s[i] + 4.0 * v * radius2 * q) * inverse
                    along_q = 0.25 * ((2.0 * qt + bracket) * whole + v * t[i]) - 0.5 * shared
                    along_q += qt - 2.0 * radius2
                    along_z2 = 0.5 * qt * whole - 0.5 * shared + 2.0 * radius2 + qt
                    h_z = 2.0 * (common * along_q - 2.0 * axial * v * inverse)
                    axial_z2 = common * along_z2 - axial * (2.0 * u[i] + 4.0 * q) * inverse
                    axial_z = 2.0 * above * axial_z2
                    # h and axial are homogeneous of degree -2 and -1 in all lengths, and obey the field laws.
                    factors[0, row, 0, node, start + i] = h
                    factors[1, row, 0, node, start + i] = axial
                    factors[0, row, 1, node, start + i] = h_z
                    factors[1, row, 1, node, start + i] = axial_z
                    factors[0, row, 2, node, start + i] = (axial_z - above * h_z) / radius
                    factors[1, row, 2, node, start + i] = -(axial + q * h_z + above * axial_z) / radius
