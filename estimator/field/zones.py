"""Quadrature rules by distance from a winding: points far from it need few loops, whatever stands nearer.

The rule of a point follows from its own distance alone, so a prediction does not depend on what else is asked for with it. Rules are found
once for a winding and remembered.
"""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass
from functools import lru_cache

from jaxtyping import Float, Int

from estimator.field.coil import AnyWinding, distance_to_coil, rule_of_coil
from estimator.field.sided import SidedWinding
from estimator.field.winding import Rule, Winding
from estimator.tensors import Tensor, torch

ZONES_PER_OCTAVE = 2  # of the distance; one would take twice the loops at the far end of each zone
POINTS_PER_EDGE = 6  # of the contour on which the rule of a zone is found; eight edges have the 48 points that `choose_rule` looks at
# Bounds of the zones, in cells and in radii: nearer is summed in full; farther needs no more than at this distance.
NEAREST_CELLS, FARTHEST_RADII = 0.05, 16.0
# Around a section of straight sides its contour is followed at these places, over half the sides: middles, corners, and between.
EDGES = ((1.0, 0.0), (1.0, 0.5), (1.0, 1.0), (0.5, 1.0), (0.0, 1.0))
DIAGONAL = math.sqrt(0.5)
AWAY = (  # in which directions from the middle of the section: along its sides and from its corners
    *((1.0, 0.0), (DIAGONAL, DIAGONAL), (0.0, 1.0), (-DIAGONAL, DIAGONAL)),
    *((-1.0, 0.0), (-DIAGONAL, -DIAGONAL), (0.0, -1.0), (DIAGONAL, -DIAGONAL)),
)


@dataclass(frozen=True)
class Zone:
    """Points that share a rule.

    Attributes:
        rule: The rule.
        points: Numbers of the points.
    """

    rule: Rule
    points: Int[Tensor, " point"]


def zones_of(winding: AnyWinding, distance_m: Float[Tensor, " point"], tolerance: float) -> tuple[Zone, ...]:
    """Points about a winding by the rule that they need, finest rule first.

    Args:
        winding: One winding (no batch).
        distance_m: Distance of each point from the cross-section, from `distance_to_coil`; points inside it go with the farthest.
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


def rules_by_level(winding: AnyWinding, tolerance: float) -> tuple[int, tuple[Rule, ...]]:
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
    shape = _shape(winding)
    nearest_m, farthest_m = _ends_m(winding)
    first, last = (math.floor(ZONES_PER_OCTAVE * math.log2(end_m)) for end_m in (nearest_m, farthest_m))
    return first, tuple(_rule_at(shape, level, tolerance) for level in range(first, last + 1))


def _ends_m(winding: AnyWinding) -> tuple[float, float]:
    """Distances between which rules differ."""
    if isinstance(winding, SidedWinding):
        half_m = 0.5 * float(torch.maximum(winding.side_x_m, winding.side_y_m)) + float(winding.thickness_m)
    else:
        half_m = float(winding.radius_m)
    cell_m = float(torch.minimum(winding.axial_pitch_m, winding.radial_pitch_m))
    return NEAREST_CELLS * cell_m, FARTHEST_RADII * half_m


# Whether corners are round, None of a round winding; its numbers.
Shape = tuple[bool | None, tuple[float, ...]]


def _shape(winding: AnyWinding) -> Shape:
    """What tells one winding from another, without tensors."""
    if isinstance(winding, SidedWinding):
        return winding.is_rounded, tuple(float(number) for number in winding.numbers)
    return None, tuple(float(number) for number in astuple(winding))


@lru_cache(maxsize=4096)
def _rule_at(shape: Shape, level: int, tolerance: float) -> Rule:
    """The rule for all points of a zone, found at the contour of points at its near end, where its error is largest."""
    is_rounded, numbers = shape[0], [torch.tensor(number, dtype=torch.float64) for number in shape[1]]
    distance_m = 2.0 ** (level / ZONES_PER_OCTAVE)
    if is_rounded is None:
        winding = Winding(*numbers)
        return rule_of_coil(winding, _contour_m(winding, distance_m), tolerance)
    sided = SidedWinding(is_rounded, *numbers)
    return rule_of_coil(sided, _contour_of_sides_m(sided, distance_m), tolerance)


def _contour_of_sides_m(winding: SidedWinding, distance_m: float) -> Float[Tensor, "point 3"]:
    """Points at one distance from a winding with straight sides, around its section in the middle of a side, in a corner, and between."""
    half_m = torch.stack((winding.side_x_m, winding.side_y_m)) / 2.0
    across = torch.tensor(EDGES, dtype=torch.float64)
    outwards = (across == 1.0).to(torch.float64)
    outwards = outwards / outwards.norm(dim=1, keepdim=True)
    corner_m = (1.0 - math.sqrt(0.5)) * winding.corner_radius_m * (across == 1.0).all(1)[:, None]
    middle_m = across * half_m - corner_m + 0.5 * winding.thickness_m * outwards
    away = torch.tensor(AWAY, dtype=torch.float64)
    sizes_m = torch.stack((winding.thickness_m, winding.length_m))
    beside_m, height_m = (0.5 * sizes_m * away.sign() + distance_m * away).unbind(-1)
    height_m = height_m - 0.5 * winding.length_m
    flat_m = middle_m[:, None] + beside_m[:, None] * outwards[:, None]
    points_m = torch.cat((flat_m, height_m.expand(len(EDGES), -1)[..., None]), dim=-1).flatten(0, 1)
    is_there = distance_to_coil(points_m, winding) > 0.5 * distance_m
    return points_m[is_there]


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
