"""What formats with windings of straight sides share: whether corners are round, and the points along an arc."""

from __future__ import annotations

from jaxtyping import Float

from estimator.export.plain_model import PlainCoil
from estimator.field.quadrature import arcs_of
from estimator.field.sided import SidedWinding
from estimator.tensors import Tensor, torch


def is_rounded(coil: PlainCoil) -> bool:
    """Whether a coil has corners that are arcs."""
    return isinstance(coil.winding, SidedWinding) and coil.winding.is_rounded


def first_arc(n: int) -> Float[Tensor, "point 3"]:
    """Cosine, sine and weight of the points of the arc in the first quarter, by the rule of Gauss and Legendre."""
    return torch.from_numpy(arcs_of(n)[:n, :3])
