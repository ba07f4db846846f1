"""Windings of any shape, and the choice of the few loops that replace all loops of one."""

from __future__ import annotations

from abc import ABC, abstractmethod
from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, TypeVar

from jaxtyping import Float

from estimator.field.node_sum import SumMode
from estimator.tensors import Tensor, torch

DEFAULT_TOLERANCE = 1e-6
NODE_LADDER = (1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512, 768, 1024)
MOST_TRIED = 48  # points at which a rule is compared with the full sum
EVERY_FEW = 4  # of these are tried first, since most rules fail at one of them
W = TypeVar("W", bound="WindingShape")


@dataclass(frozen=True)
class Rule:
    """A quadrature rule: axial and radial nodes that stand for the loops.

    `steps` is the effort for each: AGM steps of a round loop, points along each arc of one with straight sides.
    """

    axial_nodes: int
    radial_nodes: int
    steps: int


class WindingShape(ABC):
    """Geometry of a winding; every number may carry a batch, and the last four are those of its loops."""

    axial_loops: Float[Tensor, "*batch"]
    radial_loops: Float[Tensor, "*batch"]
    axial_pitch_m: Float[Tensor, "*batch"]
    radial_pitch_m: Float[Tensor, "*batch"]

    @property
    def kind(self) -> tuple[bool, ...]:
        """Attributes besides numbers in which windings of one class differ."""
        return ()

    @property
    def numbers(self) -> tuple[Tensor, ...]:
        """All of its numbers."""
        everything: Any = self
        return tuple(getattr(self, each.name) for each in fields(everything)[len(self.kind) :])

    def like(self: W, numbers: Sequence[Tensor]) -> W:
        """A winding of this kind with other numbers."""
        return type(self)(*self.kind, *numbers)

    @property
    def length_m(self) -> Float[Tensor, "*batch"]:
        """Axial extent of the winding."""
        return self.axial_pitch_m * self.axial_loops

    @property
    def thickness_m(self) -> Float[Tensor, "*batch"]:
        """Extent of the layers across the wire, from the bore outwards."""
        return self.radial_pitch_m * self.radial_loops

    @property
    @abstractmethod
    def half_width_m(self) -> Float[Tensor, "*batch"]:
        """Half of its largest extent across the axis."""

    @abstractmethod
    def distance_m(self, points_coil_m: Float[Tensor, "*#batch point 3"]) -> Float[Tensor, "*batch point"]:
        """Distance from points of the coil frame to the space that the winding fills; 0 inside it."""

    @abstractmethod
    def contour_m(self, distance_m: float) -> Float[Tensor, "point 3"]:
        """Points at one distance from the winding, all around its section (no batch)."""

    @abstractmethod
    def full_rule(self, points_coil_m: Float[Tensor, "*batch point 3"]) -> Rule:
        """The rule that sums all loops of a winding with whole loop counts."""

    @abstractmethod
    def field_by(self, rule: Rule, mode: SumMode = SumMode.PLAIN) -> Callable[[Tensor], Tensor]:
        """Field of one ampere by a rule, in T/A, as a function of points in the coil frame."""

    def with_integer_loops(self: W) -> W:
        """This winding with its loop counts rounded to the nearest whole numbers, at least 1."""
        *others, axial, radial, axial_m, radial_m = self.numbers
        counts = (count.round().clamp(min=1.0) for count in (axial, radial))
        return self.like((*others, *counts, axial_m, radial_m))


def choose_rule(
    winding: WindingShape, points_coil_m: Float[Tensor, "point 3"], tolerance: float = DEFAULT_TOLERANCE
) -> Rule:
    """The smallest rule that meets the tolerance at these points, by comparison with the exact sum.

    Args:
        winding: One winding (no batch).
        points_coil_m: Points outside the winding. The 48 nearest decide: the error of a Gauss rule grows towards the winding.
        tolerance: Largest error relative to |B|; 0 asks for the full sum, without trials.
    Returns: A rule whose error at the 48 points is below a third of the tolerance, or the full sum.
    """
    with torch.no_grad():
        # Single precision would not show whether a tolerance is met.
        points_coil_m = points_coil_m.double()
        rounded = winding.like([number.double() for number in winding.numbers]).with_integer_loops()
        distance_m = rounded.distance_m(points_coil_m)
        few = torch.topk(distance_m, min(MOST_TRIED, len(distance_m)), largest=False).indices
        nearest = points_coil_m[few]
        full = rounded.full_rule(nearest)
        if tolerance == 0.0:
            return full
        reference = rounded.field_by(full)(nearest)

        def is_accurate(rule: Rule) -> bool:
            field = rounded.field_by(rule)
            return all(_agree(field(nearest[::n]), reference[::n], tolerance / 3.0) for n in (EVERY_FEW, 1))

        return _smallest_rule(rounded, full, is_accurate)


def _agree(field: Float[Tensor, "point 3"], reference: Float[Tensor, "point 3"], largest: float) -> bool:
    """Whether a field misses another by no more than this share of it at each point."""
    return bool(((field - reference).norm(dim=-1) <= largest * reference.norm(dim=-1)).all())


def _smallest_rule(winding: WindingShape, full: Rule, is_accurate: Callable[[Rule], bool]) -> Rule:
    """The rule with the least effort that does for the full sum: for a loop where that can be less, then along, then across."""
    if winding.kind:
        full = _first_accurate("steps", full, is_accurate)
    return _first_accurate("radial_nodes", _first_accurate("axial_nodes", full, is_accurate), is_accurate)


def _first_accurate(number: str, full: Rule, is_accurate: Callable[[Rule], bool]) -> Rule:
    """The rule in which one of the numbers is as small as it may be; found by halving, since errors fall along the ladder."""
    fewer = [replace(full, **{number: n}) for n in NODE_LADDER if n < getattr(full, number)]
    return [*fewer, full][bisect_left(fewer, True, key=is_accurate)]
