"""A coil's field whose first derivatives cost a few directions, however many parameters move the points or the winding.

A rig has tens of parameters, and all reach a coil's field through the three coordinates of each point and the five numbers of the winding.
The derivatives in those eight are taken first; the chain rule does the rest.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields

import torch
from jaxtyping import Float
from torch import Tensor
from torch.func import jacfwd

from estimator.field.winding import Winding


def with_cheap_slope(
    field_per_ampere: Callable[[Tensor, Winding], Tensor],
    points_coil_m: Float[Tensor, "*#batch point 3"],
    winding: Winding,
    is_winding_fixed: bool,
) -> Float[Tensor, "*batch point 3"]:
    """The field with the right value and first derivatives; second ones are missing.

    Args:
        field_per_ampere: Of points and a winding; differentiable.
        points_coil_m: Points in the coil frame.
        winding: Geometry.
        is_winding_fixed: No derivative in it is wanted.

    Examples:
        >>> from estimator.field.winding import exact_rule, winding_field_per_ampere
        >>> one = torch.ones((), dtype=torch.float64)
        >>> loop = Winding(0.051 * one, one, one, 2e-3 * one, 2e-3 * one)
        >>> points = torch.tensor([[0.0, 0.0, 0.02]], dtype=torch.float64)
        >>> rule = exact_rule(loop, points)
        >>> def plain(points, winding):
        ...     return winding_field_per_ampere(points, winding, rule)
        >>> slope = jacfwd(lambda at: with_cheap_slope(plain, at, loop, True))(points)
        >>> bool(torch.allclose(slope, jacfwd(lambda at: plain(at, loop))(points)))
        True
    """
    numbers = [getattr(winding, field.name) for field in fields(Winding)]
    here_m, fixed = points_coil_m.detach(), [number.detach() for number in numbers]

    def near(step: Tensor) -> tuple[Tensor, Tensor]:
        moved = fixed if is_winding_fixed else [n + d for n, d in zip(fixed, step[3:], strict=True)]
        field = field_per_ampere(here_m + step[:3], Winding(*moved))
        return field, field

    still = torch.zeros(3 if is_winding_fixed else 3 + len(numbers), dtype=points_coil_m.dtype)
    slope, value = jacfwd(near, has_aux=True)(still)
    field: Tensor = value + (slope[..., :3] @ (points_coil_m - here_m)[..., None])[..., 0]
    if not is_winding_fixed:
        for i, (number, at) in enumerate(zip(numbers, fixed, strict=True)):
            field = field + slope[..., 3 + i] * (number - at)[..., None, None]
    return field
