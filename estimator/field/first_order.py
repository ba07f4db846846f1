"""First derivatives of a coil's field at a cost that does not grow with the number of parameters.

A rig has tens of parameters. All of them reach a coil's field through the three coordinates of each point, the five numbers of the winding
and the few of an effect. The derivatives in these are taken first; the chain rule does the rest.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from jaxtyping import Float

from estimator.derivatives import value_and_jacobian
from estimator.tensors import Tensor, torch


def first_order_field(
    field: Callable[[Tensor, Sequence[Tensor]], Tensor],
    points_coil_m: Float[Tensor, "*#batch point 3"],
    numbers: Sequence[Float[Tensor, "*#batch"]],
) -> Float[Tensor, "*batch point component"]:
    """The field with exact value and first derivatives, but without second ones.

    Args:
        field: Differentiable function of points and numbers. It returns the components of one field, or of several, at each point.
        points_coil_m: Points in the coil frame.
        numbers: Parameters of winding and effect. Derivatives are taken in these and in the points only.

    Examples:
        >>> points = torch.tensor([[0.0, 0.0, 0.02]], dtype=torch.float64)
        >>> from estimator.derivatives import jacobian_of
        >>> radius_m = torch.tensor(0.05, dtype=torch.float64)
        >>> def dipole(points_m, numbers):
        ...     return numbers[0] ** 2 * points_m / points_m.norm(dim=-1, keepdim=True) ** 3
        >>> jacobian = jacobian_of(lambda r: first_order_field(dipole, points, [r[0]]), radius_m[None])[..., 0]
        >>> bool(torch.allclose(jacobian, jacobian_of(lambda r: dipole(points, [r[0]]), radius_m[None])[..., 0]))
        True
    """
    fixed_points_m, fixed_numbers = points_coil_m.detach(), [number.detach() for number in numbers]

    def field_at_step(step: Tensor) -> Tensor:
        moved_numbers = [number + delta for number, delta in zip(fixed_numbers, step[3:], strict=True)]
        return field(fixed_points_m + step[:3], moved_numbers)

    no_step = torch.zeros(3 + len(numbers), dtype=points_coil_m.dtype, device=points_coil_m.device)
    value, jacobian = value_and_jacobian(field_at_step, no_step)
    return carrying_slopes(value, jacobian, points_coil_m, numbers)


def carrying_slopes(
    value: Float[Tensor, "*batch point component"],
    slopes: Float[Tensor, "*batch point component slope"],
    points_coil_m: Float[Tensor, "*#batch point 3"],
    numbers: Sequence[Float[Tensor, "*#batch"]] = (),
) -> Float[Tensor, "*batch point component"]:
    """A value that has given derivatives in the coordinates of its point, then in some numbers.

    Args:
        value, slopes: Without derivatives of their own.
        points_coil_m, numbers: As in `first_order_field`.
    """
    # Each difference below is zero and carries the derivative.
    total: Tensor = value + (slopes[..., :3] @ (points_coil_m - points_coil_m.detach())[..., None])[..., 0]
    for i, number in enumerate(numbers):
        total = total + slopes[..., 3 + i] * (number - number.detach())[..., None, None]
    return total
