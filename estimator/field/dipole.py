"""Field of a point dipole."""

from __future__ import annotations

from jaxtyping import Float

from estimator.tensors import Tensor


def dipole_field(
    from_dipole_m: Float[Tensor, "*#batch #point 3"], moment: Float[Tensor, "*#batch #point 3"]
) -> Float[Tensor, "*batch point 3"]:
    """Field in units of mu0 / 4 pi; with the field at a ball of unit radius as moment, what that adds if it is of soft iron.

    Args:
        from_dipole_m: Points from the dipole, not at it.
        moment: Its moment; in A m2 the field is in A / m times 4 pi.
    References: Jackson, Classical Electrodynamics, 3rd ed., sections 5.6 and 5.11.
    Examples:
        >>> import torch
        >>> up = torch.tensor([[0.0, 0.0, 1.0]])
        >>> dipole_field(2.0 * up, up)
        tensor([[0.0000, 0.0000, 0.2500]])
    """
    square = (from_dipole_m**2).sum(-1, keepdim=True)
    along = (from_dipole_m * moment).sum(-1, keepdim=True)
    return (3.0 * from_dipole_m * along - square * moment) * square**-2.5
