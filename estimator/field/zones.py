"""Quadrature rules by distance from a winding: points far from it need few loops, whatever stands nearer.

The rule of a point follows from its own distance alone, so a prediction does not depend on what else is asked for with it. Rules are found
once for a winding and remembered.
"""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass
from functools import lru_cache

import torch
from jaxtyping import Float, Int
from torch import Tensor

from estimator.field.winding import Rule, Winding, choose_rule

ZONES_PER_OCTAVE = 2  # of the distance; one would take twice the loops at the far end of each zone
POINTS_PER_EDGE = 6  # of the contour on which the rule of a zone is found; eight edges have the 48 points that `choose_rule` looks at
NEAREST_CELLS, FARTHEST_RADII = (
    0.05,
    16.0,
)  # nearer is summed in full; farther needs no more than at this distance


@dataclass(frozen=True)
class Zone:
    """Points that share a rule.

    Attributes:
        rule: The rule.
        points: Numbers of the points.
    """

    rule: Rule
    points: Int[Tensor, " point"]


def zones_of(winding: Winding, distance_m: Float[Tensor, " point"], tolerance: float) -> tuple[Zone, ...]:
    """Points about a winding by the rule that they need, finest rule first.

    Args:
        winding: One winding (no batch).
        distance_m: Distance of each point from the cross-section, from `distance_to_winding`; points inside it go with the farthest.
        tolerance: Largest error relative to |B|; 0 asks for the full sum.
    """
    numbers = tuple(float(number) for number in astuple(winding))
    nearest_m, farthest_m = _ends_m(numbers)
    distance_m = torch.where(distance_m > 0.0, distance_m, math.inf).clamp(nearest_m, farthest_m)
    level = torch.floor(ZONES_PER_OCTAVE * torch.log2(distance_m)).to(torch.int64)
    rules = {int(number): _rule_at(numbers, int(number), tolerance) for number in level.unique()}
    finest_first = sorted(set(rules.values()), key=lambda r: (-r.axial_nodes * r.radial_nodes, -r.steps))
    number_of = {number: finest_first.index(rule) for number, rule in rules.items()}
    zone = torch.tensor([number_of[number] for number in level.tolist()])
    return tuple(Zone(rule, (zone == i).nonzero().flatten()) for i, rule in enumerate(finest_first))


def rules_by_level(winding: Winding, tolerance: float) -> tuple[int, tuple[Rule, ...]]:
    """Rules at all distances: that of a distance d stands at floor(ZONES_PER_OCTAVE log2 d), less the number of the first.

    Args:
        winding, tolerance: As in `zones_of`.
    Returns: Number of the first level, and the rule of each level from it on; distances beyond either end take the rule at that end.
    Examples:
        >>> ten, pitch_m = torch.tensor([10.0, 1e-3], dtype=torch.float64)
        >>> first, rules = rules_by_level(Winding(5.0 * ten * pitch_m, ten, ten, pitch_m, pitch_m), 1e-6)
        >>> first, rules[0], rules[-1]
        (-29, Rule(axial_nodes=10, radial_nodes=10, steps=6), Rule(axial_nodes=2, radial_nodes=2, steps=3))
    """
    numbers = tuple(float(number) for number in astuple(winding))
    nearest_m, farthest_m = _ends_m(numbers)
    first, last = (math.floor(ZONES_PER_OCTAVE * math.log2(end_m)) for end_m in (nearest_m, farthest_m))
    return first, tuple(_rule_at(numbers, level, tolerance) for level in range(first, last + 1))


def _ends_m(numbers: tuple[float, ...]) -> tuple[float, float]:
    """Distances between which rules differ."""
    return NEAREST_CELLS * min(numbers[3:]), FARTHEST_RADII * numbers[0]


@lru_cache(maxsize=4096)
def _rule_at(numbers: tuple[float, ...], level: int, tolerance: float) -> Rule:
    """The rule for all points of a zone, found at the contour of points at its near end, where its error is largest."""
    winding = Winding(*(torch.tensor(number, dtype=torch.float64) for number in numbers))
    return choose_rule(winding, _contour_m(winding, 2.0 ** (level / ZONES_PER_OCTAVE)), tolerance)


def _contour_m(winding: Winding, distance_m: float) -> Float[Tensor, "point 3"]:
    """Points at one distance from the cross-section, all around it, in the half-plane of the coil frame that holds it."""
    inner_m, outer_m = float(winding.radius_m - winding.thickness_m), float(winding.radius_m)
    length_m = float(winding.length_m)
    along = torch.linspace(0.0, 1.0, POINTS_PER_EDGE, dtype=torch.float64)
    turn = 0.5 * math.pi * along
    rho_m = inner_m + (outer_m - inner_m) * along
    z_m = -length_m * along
    round_m, up_m = distance_m * torch.cos(turn), distance_m * torch.sin(turn)
    parts = [
        (rho_m, torch.full_like(rho_m, distance_m)),
        (rho_m, torch.full_like(rho_m, -length_m - distance_m)),
        (torch.full_like(z_m, outer_m + distance_m), z_m),
        (torch.full_like(z_m, inner_m - distance_m), z_m),
        *((outer_m + round_m, height_m) for height_m in (up_m, -length_m - up_m)),
        *((inner_m - round_m, height_m) for height_m in (up_m, -length_m - up_m)),
    ]
    rho_m, z_m = (torch.cat(coordinate) for coordinate in zip(*parts, strict=True))
    is_there = rho_m >= 0.0  # in a bore narrower than the distance there are no such points
    return torch.stack((rho_m, torch.zeros_like(rho_m), z_m), dim=-1)[is_there]
