"""Corrections of where a mover stands: along its guides, with time, and after its moves."""

from __future__ import annotations

import math
from collections.abc import Sequence

from jaxtyping import Float

from estimator.effects.base import Quantities, Starts, Theta, box, shape, vector
from estimator.effects.circumstances import Circumstances, Extent
from estimator.effects.corrections.bases import (
    MOST_HALF_CYCLES,
    SMALLEST_SPAN,
    AlongWay,
    Periodic,
    Steps,
    Wanders,
    ends_of_ways,
)
from estimator.effects.corrections.correction import Correction, Limit, Scale, constant, correction
from estimator.effects.corrections.targets import Place
from estimator.effects.stages import Columns, MotionEffect
from estimator.frames import Transform, rotation_from_vector
from estimator.tensors import Tensor, torch

STRAIGHT_DEGREE = 3  # up to which a guide may bend across itself; beyond, only the screw's own error is asked
SHORTEST_PERIOD_M = 0.5e-3  # finer pitches are rarer than errors that look like them
LEAST_LENGTH_M = 1e-9
BY_MOVE, BY_SIDE, BY_MOVE_AND_TIME = 1, 2, 3
N_DIRECTIONS = 48  # of a half sphere: any direction is within 15 degrees of one of them
LEAST_MOVE = 1e-3  # of a typical move: less is rounding
UNIT = ("unit_x", "unit_y", "unit_z")


def _span_m(circumstances: Circumstances, mover: str) -> float:
    """The longest way of a mover along an axis."""
    at_m = circumstances.positions_of_m(mover)
    return float((at_m.max(0).values - at_m.min(0).values).max())


def _number_of_positions(circumstances: Circumstances, place: str) -> int:
    """Fewest different positions along an axis along which the mover moved."""
    at_m = circumstances.positions_of_m(place)
    span_m = at_m.max(0).values - at_m.min(0).values
    moved = [i for i in range(3) if float(span_m[i]) > SMALLEST_SPAN * float(span_m.max())]
    return min(len(torch.unique((at_m[:, i] / (SMALLEST_SPAN * span_m[i])).round())) for i in moved)


class GuideErrors(Place, AlongWay):
    """Along each axis the mover errs by cosines of half waves over the way that it went; beyond, they repeat as in a mirror."""

    name = "guide_errors"
    words = "the mover errs smoothly along its guides"
    highest = 12

    def terms(self, degree: int) -> tuple[str, ...]:
        """What errs along which axis: `z_along_x`."""
        is_bent = degree <= STRAIGHT_DEGREE
        return tuple(f"{axis}_along_{way}" for way in "xyz" for axis in ("xyz" if is_bent else way))

    def shapes(self, extent: Extent) -> Quantities:
        """Beginning and length of the mover's way along each axis, in m."""
        return tuple(end for ends in zip(*ends_of_ways(extent), strict=True) for end in ends)

    def at_m(self, circumstances: Circumstances, place: str) -> Float[Tensor, "reading 3"]:
        """Reported positions of the mover."""
        return circumstances.positions_of_m(place)

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether the mover moved."""
        return _span_m(circumstances, place) > 0.0

    def limit(self, circumstances: Circumstances, place: str) -> Limit:
        """Highest degree that the readings determine; it is below the number of positions along each axis along which the mover moved."""
        n, bound = _number_of_positions(circumstances, place), super().limit(circumstances, place)
        if n > self.highest or bound.degree < n:
            return bound
        return Limit(n - 1, f"the mover was at {n} positions along one axis; measure at more")

    def variable(self, pose: Transform, columns: Columns, theta: Theta) -> Tensor:
        """Reported position, which ways are shares of."""
        return pose.translation_m


@correction(
    Place,
    Wanders,
    words="where the mover stands wanders with time",
    highest=12,
    # Share of the session that has gone.
    columns=lambda circumstances: (circumstances.hours_for_instants / circumstances.duration_h)[:, None],
)
def guides_wander(columns: Columns, theta: Theta) -> Tensor:
    """The mover's real position wanders: it warms up, creeps, or its clock runs apart from the sensor's."""
    return columns * constant(theta, "duration_h")


def _frequencies(circumstances: Circumstances, place: str) -> Starts:
    """Frequencies half a cycle over the longest way apart, as many as there are readings at most."""
    spacing = 0.5 / max(_span_m(circumstances, place), SHORTEST_PERIOD_M)
    n = min(len(circumstances), MOST_HALF_CYCLES, int(1.0 / (SHORTEST_PERIOD_M * spacing)))
    return tuple({"frequency_per_m": (i + 1) * spacing} for i in range(max(1, n)))


@correction(
    Place,
    Periodic,
    shapes=(shape("frequency_per_m", "1/m", 0.0, 1.0 / SHORTEST_PERIOD_M),),
    starts=_frequencies,
    concerns=lambda circumstances, place: _span_m(circumstances, place) > SHORTEST_PERIOD_M,
)
def guide_swings(pose: Transform, theta: Theta) -> Tensor:
    """The mover errs with a period along its guides.

    Each axis of a mover runs fast and slow with one period along its way, as of a screw or a rack.
    """
    return pose.translation_m * theta["frequency_per_m"][..., None, None]


@correction(Place, Steps, words="where the mover stands jumps", single="mover_slipped", highest=4)
def guides_step() -> None:
    """The mover's real position jumps: a slipped clamp, a lost step, a knock."""


def _rms_of_moves_m(circumstances: Circumstances, mover: str) -> float:
    """The rms of the last moves."""
    rms_m = float(circumstances.last_move_m(mover).square().sum(-1).mean().sqrt())
    return max(rms_m, LEAST_LENGTH_M)


# A typical move, and the radius of arcs.
MOVE = Scale("move_m", "m", lambda extent: 100.0 * extent.reach_m, _rms_of_moves_m)
REACH = Scale(
    "reach_m", "m", lambda extent: 100.0 * extent.reach_m, lambda now, _: max(now.reach_m, LEAST_LENGTH_M)
)


class AfterMoves(Correction, MotionEffect):
    """Place of a mover after its last move: play, overshoot, loose mounts, and clocks that do not agree."""

    unit = "m"
    depends_on = "how the mover came to where it stands"

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether the mover moved."""
        return bool((circumstances.last_move_m(place) != 0.0).any())


class MovesRemembered(AfterMoves):
    """The mover stands elsewhere, and is turned, by an amount that depends on the move that led there.

    Degree 1 is proportional to the last move, degree 2 depends on the side from which each axis came, and degree 3 is proportional to the
    last move and to time, as of two clocks that run apart.
    """

    name = "moves_remembered"
    words = "where the mover stands depends on the move that led there"
    scales = (MOVE, REACH)
    highest = 3
    counts = ("different moves", lambda now, place: (1e6 * now.last_move_m(place)).round())

    def terms(self, degree: int) -> tuple[str, ...]:
        """What errs after a move along which axis: `z_after_x`; `rz_after_x` turns, as an arc at the reach."""
        kinds = ("", "r") if degree == BY_SIDE else ("",)
        return tuple(f"{kind}{axis}_after_{way}" for kind in kinds for axis in "xyz" for way in "xyz")

    def columns(self, circumstances: Circumstances, mover: str) -> Columns:
        """The last move, the side from which each axis came, and the last move times the share of the session that has gone."""
        move_m = circumstances.last_move_m(mover)
        gone = (circumstances.hours / circumstances.duration_h)[:, None]
        return torch.cat((move_m, circumstances.approach(mover), gone * move_m), dim=-1)

    def apply(self, pose: Transform, columns: Columns, theta: Theta) -> Transform:
        """Real pose, or real displacement."""
        move_m, side, late_move_m = columns.unflatten(-1, (3, 3)).unbind(-2)
        typical_m, reach_m = (constant(theta, key) for key in ("move_m", "reach_m"))
        by_degree = {BY_MOVE: move_m / typical_m, BY_SIDE: side, BY_MOVE_AND_TIME: late_move_m / typical_m}
        shift_m, rotation = torch.zeros_like(move_m), pose.rotation
        for degree, amplitude in self.amplitudes(theta).items():
            matrices = amplitude.unflatten(-1, (-1, 3, 3))
            shift_m = shift_m + by_degree[degree] @ matrices[..., 0, :, :].mT
            if degree == BY_SIDE:
                turn_rad = by_degree[degree] @ matrices[..., 1, :, :].mT / reach_m
                rotation = rotation @ rotation_from_vector(turn_rad)
        return Transform(rotation, pose.translation_m + shift_m)


class SidesRemembered(AfterMoves):
    """What is loose along one direction: the mover stands, and is turned, to the side that its last move along that direction left.

    The direction need not be an axis of the mover. It is one of a set that covers the half sphere.
    """

    name = "sides_remembered"
    words = "the mover stands on the side that its last move along some direction left"
    components = ("x", "y", "z", "rx", "ry", "rz")  # shifts, and turns as arcs at the reach
    scales = (REACH,)
    highest = 1

    def shapes(self, extent: Extent) -> Quantities:
        """The direction, and the radius of the arcs."""
        return (*box(UNIT, "", "1", 1.0, is_fixed=True), *super().shapes(extent))

    def starts(self, circumstances: Circumstances, place: str) -> Starts:
        """One for each way in which the moves of the session can be divided; the first of alike ones."""
        _, first = _distinct_rows(_sides(circumstances, place).T)
        units = directions()[first.tolist()].tolist()
        [scales] = super().starts(circumstances, place)
        return tuple(dict(zip(UNIT, unit, strict=True)) | scales for unit in units)

    def factors(
        self, circumstances: Circumstances, place: str, starts: Sequence[dict[str, float]]
    ) -> Float[Tensor, "start reading"]:
        """The sides, with those of the first start for plus."""
        units = circumstances.hours.new_tensor([[start[key] for key in UNIT] for start in starts])
        sides = _sides(circumstances, place)[:, _nearest(units)].T
        return sides * sides[0]

    def limit(self, circumstances: Circumstances, place: str) -> Limit:
        """Highest degree that the number of readings determines; 0 where all moves left the mover on one side."""
        if bool((_sides(circumstances, place) == 1.0).all()):
            return Limit(0, "the mover went to one side only; come to some places from the other")
        return super().limit(circumstances, place)

    def columns(self, circumstances: Circumstances, mover: str) -> Columns:
        """The side along each direction of the set."""
        return _sides(circumstances, mover)

    def apply(self, pose: Transform, columns: Columns, theta: Theta) -> Transform:
        """Real pose, or real displacement."""
        side = columns.T[_nearest(vector(theta, UNIT)[..., 0, :])]
        [amplitude] = self.amplitudes(theta).values()
        shift_m, arc_m = (side[..., None] * amplitude[..., None, :]).split(3, dim=-1)
        turn = rotation_from_vector(arc_m / constant(theta, "reach_m"))
        return Transform(pose.rotation @ turn, pose.translation_m + shift_m)


def directions() -> Float[Tensor, "direction 3"]:
    """Directions that cover the half sphere evenly, on a spiral of the golden angle."""
    height = (torch.arange(N_DIRECTIONS, dtype=torch.float64) + 0.5) / N_DIRECTIONS
    azimuth = math.pi * (3.0 - math.sqrt(5.0)) * torch.arange(N_DIRECTIONS, dtype=torch.float64)
    across = torch.sqrt(1.0 - height**2)
    units = torch.stack((across * torch.cos(azimuth), across * torch.sin(azimuth), height), dim=-1)
    return (1e6 * units).round() / 1e6


def _nearest(unit: Float[Tensor, "*batch 3"]) -> Tensor:
    """Number of the direction of the set that is nearest."""
    return (unit @ directions().to(unit).T).argmax(-1)


def _sides(circumstances: Circumstances, mover: str) -> Float[Tensor, "reading direction"]:
    """Sign of the last move along each direction; plus before the first, as after a way forwards. A moment has no side."""
    if circumstances.is_moment:
        return circumstances.hours.new_zeros(len(circumstances), N_DIRECTIONS)
    move_m = circumstances.moves_m(mover)
    length_m = move_m.norm(dim=-1)
    typical_m = float(length_m.square().mean().sqrt())
    along_m = move_m @ directions().to(move_m).T
    is_move = along_m.abs() > LEAST_MOVE * max(typical_m, LEAST_LENGTH_M)
    last = torch.cummax(torch.arange(len(move_m), device=move_m.device)[:, None] * is_move, dim=0).values
    side = torch.where(is_move, torch.sign(along_m), torch.ones_like(along_m))
    return torch.gather(side, 0, last)[circumstances.observations.row]


def _distinct_rows(rows: Float[Tensor, "row column"]) -> tuple[Tensor, Tensor]:
    """The distinct of some rows, up to their sign, and the number of the first of each."""
    signed = rows * rows[:, :1]
    distinct, which = torch.unique(signed, dim=0, return_inverse=True)
    number = torch.arange(len(rows), device=rows.device)
    first = torch.full_like(number[: len(distinct)], len(rows)).scatter_reduce(0, which, number, "amin")
    return distinct, first.sort().values
