"""Jacobians by two backward passes.

Forward-mode differentiation by `torch.func` runs Python code for every operation whose operands do not all depend on the point. With the
few hundred readings of a session that takes most of the time: two backward passes need a fifth of it, and give the same numbers.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor


def jacobian_of(
    function: Callable[[Tensor], Tensor], point: Float[Tensor, " coordinate"]
) -> Float[Tensor, "*value coordinate"]:
    """Derivatives of every value of a function in every coordinate; see `value_and_jacobian`.

    Examples:
        >>> jacobian_of(lambda x: torch.stack((x[0] * x[1], x[1] ** 2, x[0])), torch.tensor([2.0, 3.0]))
        tensor([[3., 2.],
                [0., 6.],
                [1., 0.]])
    """
    return value_and_jacobian(function, point)[1]


def value_and_jacobian(
    function: Callable[[Tensor], Tensor],
    point: Float[Tensor, " coordinate"],
    directions: Float[Tensor, "direction coordinate"] | None = None,
) -> tuple[Float[Tensor, "*value"], Float[Tensor, "*value direction"]]:
    """Values of a function, and their derivatives in every coordinate, or along given directions.

    The first pass takes the gradient of the values weighted by numbers that are free; it is linear in them. The second one differentiates
    it in these numbers, for all coordinates at once, so its cost grows with their number and not with that of the values.

    Args:
        function: Differentiable, by operations that have second derivatives.
        point: Where the derivatives are taken.
        directions: Each coordinate by default.
    Returns: Both without a graph.
    References: J. Townsend, A new trick for calculating Jacobian vector products (2017).
    """
    with torch.enable_grad():
        free = point.detach().requires_grad_()
        each = (
            torch.eye(len(point), dtype=point.dtype, device=point.device)
            if directions is None
            else directions
        )
        values = function(free)
        if not (
            values.requires_grad and len(point) and len(each)
        ):  # nothing depends on it, or none is asked for
            return values.detach(), values.new_zeros(*values.shape, len(each))
        weights = torch.zeros_like(values).requires_grad_()
        gradient = torch.autograd.grad(values, free, weights, create_graph=True, materialize_grads=True)[0]
        rows = torch.autograd.grad(gradient, weights, each, is_grads_batched=True, materialize_grads=True)[0]
    return values.detach(), rows.movedim(0, -1)
