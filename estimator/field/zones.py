"""Quadrature rules by distance from a winding: points far from it need few loops, whatever stands nearer.

The rule of a point follows from its own distance alone, so a prediction does not depend on what else is asked for with it. Rules are found
once for a winding and remembered.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

from jaxtyping import Float, Int

from estimator.field.winding_shape import Rule, WindingShape, choose_rule
from estimator.tensors import Tensor, torch

ZONES_PER_OCTAVE = 2  # of the distance; one would take twice the loops at the far end of each zone
# Bounds of the zones, in cells and in radii: nearer is summed in full; farther needs no more than at this distance.
NEAREST_CELLS, FARTHEST_RADII = 0.05, 16.0


@dataclass(frozen=True)
class Zone:
    """Points that share a rule.

    Attributes:
        rule: The rule.
        points: Numbers of the points.
    """

    rule: Rule
    points: Int[Tensor, " point"]


def zones_of(
    winding: WindingShape, distance_m: Float[Tensor, " point"], tolerance: float
) -> tuple[Zone, ...]:
    """Points about a winding by the rule that they need, finest rule first.

    Args:
        winding: One winding (no batch).
        distance_m: Distance of each point from the cross-section, from `WindingShape.distance_m`; points inside it go with the farthest.
        tolerance: Largest error relative to |B|; 0 asks for the full sum.
    """
    shape = _shape(winding)
    nearest_m, farthest_m = _ends_m(winding)
    distance_m = torch.where(distance_m > 0.0, distance_m, math.inf).clamp(nearest_m, farthest_m)
    level = torch.floor(ZONES_PER_OCTAVE * torch.log2(distance_m)).to(torch.int64)
    rules = {int(number): _rule_at(shape, int(number), tolerance) for number in level.unique()}
    finest_first = sorted(set(rules.values()), key=lambda r: (-r.axial_nodes * r.radial_nodes, -r.steps))
    number_of = {number: finest_first.index(rule) for number, rule in rules.items()}
    zone = torch.tensor([number_of[number] for number in level.tolist()], device=level.device)
    return tuple(Zone(rule, (zone == i).nonzero().flatten()) for i, rule in enumerate(finest_first))


def rules_by_level(winding: WindingShape, tolerance: float) -> tuple[int, tuple[Rule, ...]]:
    """Rules at all distances: that of a distance d stands at floor(ZONES_PER_OCTAVE log2 d), less the number of the first.

    Args:
        winding, tolerance: As in `zones_of`.
    Returns: Number of the first level, and the rule of each level from it on; distances beyond either end take the rule at that end.
    Examples:
        >>> from estimator.field.winding import Winding
        >>> ten, pitch_m = torch.tensor([10.0, 1e-3], dtype=torch.float64)
        >>> first, rules = rules_by_level(Winding(5.0 * ten * pitch_m, ten, ten, pitch_m, pitch_m), 1e-6)
        >>> first, rules[0], rules[-1]
        (-29, Rule(axial_nodes=10, radial_nodes=10, steps=6), Rule(axial_nodes=2, radial_nodes=2, steps=3))
    """
    shape = _shape(winding)
    nearest_m, farthest_m = _ends_m(winding)
    first, last = (math.floor(ZONES_PER_OCTAVE * math.log2(end_m)) for end_m in (nearest_m, farthest_m))
    return first, tuple(_rule_at(shape, level, tolerance) for level in range(first, last + 1))


def _ends_m(winding: WindingShape) -> tuple[float, float]:
    """Distances between which rules differ."""
    cell_m = float(torch.minimum(winding.axial_pitch_m, winding.radial_pitch_m))
    return NEAREST_CELLS * cell_m, FARTHEST_RADII * float(winding.half_width_m)


# Class and kind of a winding, and its numbers.
Shape = tuple[type[WindingShape], tuple[bool, ...], tuple[float, ...]]


def _shape(winding: WindingShape) -> Shape:
    """A winding as plain numbers, to compare it with others."""
    return type(winding), winding.kind, tuple(float(number) for number in winding.numbers)


@lru_cache(maxsize=4096)
def _rule_at(shape: Shape, level: int, tolerance: float) -> Rule:
    """The rule for all points of a zone, found at the contour of points at its near end, where its error is largest."""
    made, kind, numbers = shape
    winding = made(*kind, *(torch.tensor(number, dtype=torch.float64) for number in numbers))
    return choose_rule(winding, winding.contour_m(2.0 ** (level / ZONES_PER_OCTAVE)), tolerance)
