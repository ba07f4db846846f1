"""A coil's field whose first derivatives cost a few directions, however many parameters move the points or the winding.

A rig has tens of parameters, and all reach a coil's field through the three coordinates of each point, the five numbers of the winding
and the few of an effect. The derivatives in those are taken first; the chain rule does the rest.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from jaxtyping import Float
from torch import Tensor
from torch.func import jacfwd


def with_cheap_slope(
    field: Callable[[Tensor, Sequence[Tensor]], Tensor],
    points_coil_m: Float[Tensor, "*#batch point 3"],
    numbers: Sequence[Float[Tensor, "*#batch"]],
) -> Float[Tensor, "*batch point component"]:
    """The field with the right value and first derivatives; second ones are missing.

    Args:
        field: Of points and numbers; differentiable. Some components at each point: those of one field, or of several.
        points_coil_m: Points in the coil frame.
        numbers: Of winding and effect; only in these and the points is a derivative wanted.

    Examples:
        >>> points = torch.tensor([[0.0, 0.0, 0.02]], dtype=torch.float64)
        >>> radius_m = torch.tensor(0.05, dtype=torch.float64)
        >>> def dipole(points_m, numbers):
        ...     return numbers[0] ** 2 * points_m / points_m.norm(dim=-1, keepdim=True) ** 3
        >>> slope = jacfwd(lambda radius_m: with_cheap_slope(dipole, points, [radius_m]))(radius_m)
        >>> bool(torch.allclose(slope, jacfwd(lambda radius_m: dipole(points, [radius_m]))(radius_m)))
        True
    """
    here_m, here = points_coil_m.detach(), [number.detach() for number in numbers]

    def near(step: Tensor) -> tuple[Tensor, Tensor]:
        moved = field(here_m + step[:3], [n + d for n, d in zip(here, step[3:], strict=True)])
        return moved, moved

    slope, value = jacfwd(near, has_aux=True)(torch.zeros(3 + len(numbers), dtype=points_coil_m.dtype))
    total: Tensor = value + (slope[..., :3] @ (points_coil_m - here_m)[..., None])[..., 0]
    for i, (number, at) in enumerate(zip(numbers, here, strict=True)):
        total = total + slope[..., 3 + i] * (number - at)[..., None, None]
    return total
