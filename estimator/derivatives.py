"""Jacobians by two backward passes.

Forward-mode differentiation by `torch.func` runs Python code for every operation whose operands do not all depend on the point. With the
few hundred readings of a session that takes most of the time: two backward passes need a fifth of it, and give the same numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, cast

from jaxtyping import Float

from estimator.side_by_side import each
from estimator.tensors import Tensor, is_on_numpy, torch

# Entries of a Jacobian from which on its paths take less time side by side than one after another.
LARGE = 2**17


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
    each = _every(point) if directions is None else directions
    if is_on_numpy():
        return cast(Any, torch).jacobian_by_complex_steps(function, point, each)
    with torch.enable_grad():
        free = point.detach().requires_grad_()
        values = function(free)
        if not (values.requires_grad and len(point) and len(each)):
            return values.detach(), values.new_zeros(*values.shape, len(each))
        return values.detach(), _slopes(values, free, each)


def slopes_in(
    values: Float[Tensor, "*value"], point: Float[Tensor, " coordinate"]
) -> Float[Tensor, "*value coordinate"]:
    """Derivatives of values that have a graph in every coordinate of a point that they were computed from, without a graph.

    The graph stays, so that the values can be differentiated by other numbers too.
    """
    with torch.enable_grad():
        return _slopes(values, point, _every(point), keeps_graph=True)


def value_and_jacobian_by_paths(
    function: Callable[[Sequence[Float[Tensor, ""]]], Float[Tensor, "*value"]],
    point: Float[Tensor, " coordinate"],
    directions: Float[Tensor, "direction coordinate"],
    paths: Sequence[Sequence[int]],
) -> tuple[Float[Tensor, "*value"], Float[Tensor, "*value direction"]]:
    """Values of a function, and their derivatives along directions, where coordinates act through different parts of it.

    Each path has a second pass of its own, which visits nothing but what its coordinates act through.

    Args:
        function: Of coordinates that stand apart, so that their graphs do not meet before the function lets them.
        point: Where the derivatives are taken.
        directions: Along which.
        paths: Numbers of the directions that go through the same part; each direction belongs to one path.
    Returns: Both without a graph.

    Examples:
        >>> both = torch.eye(2)
        >>> value_and_jacobian_by_paths(lambda x: torch.stack((x[0] ** 2, x[1])), torch.tensor([3.0, 1.0]), both, [[0], [1]])
        (tensor([9., 1.]), tensor([[6., 0.],
                [0., 1.]]))
    """
    with torch.enable_grad():
        asked = directions.any(0).nonzero().flatten().tolist()  # only these have graphs
        coordinates = list(point.detach().clone().unbind())
        free = {i: coordinates[i].requires_grad_() for i in asked}
        values = function(coordinates)
        along = values.new_zeros(*values.shape, len(directions))
        if not (values.requires_grad and asked):
            return values.detach(), along
        weights = torch.zeros_like(values).requires_grad_()
        gradients = torch.autograd.grad(
            values, list(free.values()), weights, create_graph=True, materialize_grads=True
        )
        gradient = dict(zip(free, gradients, strict=True))

        def along_path(path: Sequence[int]) -> Tensor | None:
            along_each = directions[list(path)]
            mine = [i for i in along_each.any(0).nonzero().flatten().tolist() if gradient[i].requires_grad]
            if not mine:
                return None
            (rows,) = torch.autograd.grad(
                [gradient[i] for i in mine],
                weights,
                [along_each[:, i] for i in mine],
                retain_graph=True,
                is_grads_batched=True,
                allow_unused=True,
            )
            return rows

        is_large = along.numel() >= LARGE
        for path, rows in zip(paths, (each if is_large else map)(along_path, paths), strict=True):
            if rows is not None:
                along[..., list(path)] = rows.movedim(0, -1)
    return values.detach(), along


def _every(point: Tensor) -> Tensor:
    return torch.eye(len(point), dtype=point.dtype, device=point.device)


def _slopes(values: Tensor, free: Tensor, each: Tensor, keeps_graph: bool = False) -> Tensor:
    """Derivatives of values along directions of a point that they were computed from."""
    weights = torch.zeros_like(values).requires_grad_()
    gradient = torch.autograd.grad(values, free, weights, create_graph=True, materialize_grads=True)[0]
    nothing = values.new_zeros(*values.shape, len(each))
    if not gradient.requires_grad:
        return nothing
    (rows,) = torch.autograd.grad(
        gradient, weights, each, retain_graph=keeps_graph, is_grads_batched=True, allow_unused=True
    )
    return nothing if rows is None else rows.movedim(0, -1)  # type: ignore[redundant-expr]
