"""Sums over loops on a graphics processor in one kernel, for numbers that carry no derivatives.

The formulas are those of `field.loop`. There each of some sixty operations writes its numbers to memory; here they stay in registers, which
takes a twentieth of the time. Triton, which comes with torch's builds for graphics processors, translates the kernel when it is first
called and keeps it on disk, for which it needs a C compiler, a linker and Python's headers. Where it cannot, operations of torch do the
same (`docs/decisions/0005`).
"""

from __future__ import annotations

import inspect
import logging
from functools import cache
from importlib.util import find_spec
from typing import Any

from jaxtyping import Float

from estimator.field.kernel import QUARTER_MU0
from estimator.field.machine_code import has_derivatives
from estimator.tensors import Tensor, torch

POINTS_IN_A_BLOCK = 128

if find_spec("triton"):
    import triton
    import triton.language as tl
else:
    triton = tl = None


def is_fusable(*tensors: Tensor) -> bool:
    """Whether tensors are numbers that the kernel takes: on a graphics processor and without derivatives.

    Examples:
        >>> is_fusable(torch.ones(3))
        False
    """
    return (
        triton is not None
        and all(tensor.device.type == "cuda" for tensor in tensors)
        and not any(has_derivatives(tensor) for tensor in tensors)
        and _is_translated(tensors[0].device)
    )


def fused_sum_of_loops(
    points_m: Float[Tensor, "rows point 3"],
    height_m: Float[Tensor, "rows node"],
    radius_m: Float[Tensor, "rows node"],
    weight: Float[Tensor, "rows node"],
    steps: int,
) -> Float[Tensor, "rows point 3"]:
    """Field per ampere of weighted loops about z, row by row, in the precision of the points.

    Args:
        points_m: Points in the coil frame.
        height_m, radius_m, weight: Of the loops of every row.
        steps: AGM steps of each loop.
    """
    n_rows, n_points, _ = points_m.shape
    points, field = points_m.contiguous(), torch.empty_like(points_m, memory_format=torch.contiguous_format)
    loops = [values.contiguous() for values in (height_m, radius_m, weight)]
    n_blocks = -(-n_points // POINTS_IN_A_BLOCK)
    if field.numel():
        _kernel()[(n_rows * n_blocks,)](
            points, *loops, field, n_points, height_m.shape[1], n_blocks, STEPS=steps, BLOCK=POINTS_IN_A_BLOCK
        )
    return QUARTER_MU0 * field


def _sum(  # type: ignore[no-untyped-def]
    points,
    heights,
    radii,
    weights,
    field,
    n_points,
    n_nodes,
    n_blocks,
    STEPS: tl.constexpr,
    BLOCK: tl.constexpr,
):
    """One block of points of one row: `loop.loop_terms`, summed over the loops, without the common factor."""
    program = tl.program_id(0).to(tl.int64)
    row = program // n_blocks
    point = (program % n_blocks) * BLOCK + tl.arange(0, BLOCK)
    is_inside = point < n_points
    at = 3 * (row * n_points + point)
    x = tl.load(points + at, mask=is_inside, other=1.0)
    y = tl.load(points + at + 1, mask=is_inside, other=1.0)
    z = tl.load(points + at + 2, mask=is_inside, other=1.0)
    y2 = y * y
    rho2 = x * x + y2
    h_sum = tl.zeros_like(x)
    axial_sum = tl.zeros_like(x)
    for node in range(n_nodes):
        height = tl.load(heights + row * n_nodes + node)
        radius = tl.load(radii + row * n_nodes + node)
        weight = tl.load(weights + row * n_nodes + node)
        above = z - height
        radius2 = radius * radius
        z2 = above * above
        u = (radius - x) * (radius + x) - y2 + z2
        s = radius2 + rho2 + z2
        p2 = u * u + 4.0 * rho2 * z2
        product = tl.sqrt(p2)
        mean2 = 0.5 * (s + product)
        mean = tl.sqrt(mean2)
        t = radius2 / mean2
        square = t * 0.0625
        for n in tl.static_range(1, STEPS + 1):
            geometric = tl.sqrt(product)
            product = mean * geometric
            mean = 0.5 * (mean + geometric)
            c = square / mean
            square = rho2 * c * c
            t += (2.0 ** (n + 4)) * square
        common = weight / (mean * p2)
        h_sum += (4.0 * radius2 - s * t) * common * above
        axial_sum += (2.0 * radius2 * u + rho2 * t * (2.0 * z2 - u)) * common
    tl.store(field + at, x * h_sum, mask=is_inside)
    tl.store(field + at + 1, y * h_sum, mask=is_inside)
    tl.store(field + at + 2, axial_sum, mask=is_inside)


@cache
def _is_translated(device: torch.device) -> bool:
    """Whether the kernel runs there: a first sum tries it."""
    ones = torch.ones(1, 3, device=device)
    try:
        loop = ones[:, :1]
        fused_sum_of_loops(ones[None], loop, loop, loop, steps=3)
    except Exception as error:  # of Triton, of the compiler that it calls, or of the driver
        logging.getLogger(__name__).warning(
            "fields are computed by operations of torch, which takes ten times as long: Triton cannot translate its kernel (%s)",
            error,
        )
        return False
    return True


@cache
def _kernel() -> Any:
    """The kernel, without the checks of shapes that tests put around every function."""
    return triton.jit(inspect.unwrap(_sum), do_not_specialize=["n_points", "n_nodes", "n_blocks"])
