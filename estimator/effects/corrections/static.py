"""Corrections that are static magnetic fields: where they are (a target), and of sources in or about a ball (a basis).

A kind is a target and a basis together; `corrections.bore` has the basis of cylinders.
"""

from __future__ import annotations

from abc import abstractmethod

from jaxtyping import Float

from estimator.effects.base import POSITIVE, Kind, Quantities, Starts, Theta, box, fixed, written
from estimator.effects.circumstances import Circumstances, Extent
from estimator.effects.corrections.correction import Correction, Limit, constant, constants
from estimator.effects.history import LEAST_STEP
from estimator.effects.stages import Field, PerAmpere, Points, RoomEffect, SourceEffect
from estimator.field import harmonics
from estimator.field.coil import AnyWinding
from estimator.field.winding_shape import Rule
from estimator.frames import Transform
from estimator.rig.bodies import AnyCoil
from estimator.rig.harmonic_terms import terms
from estimator.rig.rig import Rig
from estimator.tensors import Tensor, torch

LEAST_REACH_M = 1e-6
SAME_PLACE = 1e-3  # of the reach: nearer places count once
THIN = 0.03  # of the widest extent: thinner sets of places are a plane or a line
PLANE_DEGREE = 2  # from a plane: what is off it is extrapolated from slopes across it
MIDDLE = ("middle_x_m", "middle_y_m", "middle_z_m")


def positions_m(circumstances: Circumstances, coil: AnyCoil | None = None) -> Float[Tensor, "reading 3"]:
    """Nominal position of the sensor at each reading, in the frame of a coil or in the room."""
    n = len(circumstances)
    each = [
        circumstances.world_from(sensor).translation_m.expand(n, 3) for sensor in circumstances.rig.sensors
    ]
    world_m = torch.stack(each)[circumstances.sensor, torch.arange(n, device=circumstances.sensor.device)]
    if coil is None:
        return world_m
    world_from_coil = circumstances.world_from(coil)
    turns = Transform(world_from_coil.rotation.expand(n, 3, 3), world_from_coil.translation_m.expand(n, 3))
    return turns.inverse().apply(world_m)


def limit_of_places(places_m: Float[Tensor, "reading 3"], n_terms: dict[int, int]) -> Limit:
    """How high a degree of a field the places determine at which it was read.

    Args:
        places_m: Of all readings, in the frame of the field.
        n_terms: By degree, the number of terms up to it.
    """
    lowest, highest = min(n_terms), max(n_terms)
    middle_m = places_m.mean(0)
    reach_m = float((places_m - middle_m).norm(dim=-1).max())
    if reach_m == 0.0:
        return Limit(lowest - 1, "all readings are at one place; move the sensor")
    places = torch.unique(((places_m - middle_m) / (SAME_PLACE * reach_m)).round(), dim=0)
    spread = torch.linalg.svdvals(places - places.mean(0))
    n_wide = int((spread > THIN * spread[0]).sum())
    if n_wide == 1:
        return Limit(lowest - 1, "all readings lie on one line; measure beside it, on both sides")
    enough = [degree for degree, n in n_terms.items() if n <= len(places)]
    if not enough:
        return Limit(
            lowest - 1, f"readings are at {len(places)} places; measure at {n_terms[lowest]} or more"
        )
    if n_wide == 2 and max(enough) > PLANE_DEGREE:
        return Limit(PLANE_DEGREE, "all readings lie in one plane; measure off it, on both sides")
    if max(enough) < highest:
        wanted = n_terms[max(enough) + 1]
        return Limit(max(enough), f"readings are at {len(places)} places; measure at {wanted} or more")
    return Limit(highest)


class StaticField(Correction):
    """A field without sources where it was read."""

    @abstractmethod
    def read_at_m(self, circumstances: Circumstances, place: str) -> Float[Tensor, "reading 3"]:
        """Positions at which it was read, in its frame."""

    @abstractmethod
    def around(self, places_m: Float[Tensor, "reading 3"]) -> dict[str, float]:
        """Shapes about some places."""

    @abstractmethod
    def limit_around(self, places_m: Float[Tensor, "reading 3"]) -> Limit:
        """Highest degree that some places determine."""

    @abstractmethod
    def field(self, points_m: Points, theta: Theta) -> Field:
        """Field in the frame of the points, in the unit of the amplitudes."""

    def starts(self, circumstances: Circumstances, place: str) -> Starts:
        """Shapes about the readings."""
        return (self.around(self.read_at_m(circumstances, place)),)

    def limit(self, circumstances: Circumstances, place: str) -> Limit:
        """Highest degree that the places of the readings determine."""
        return self.limit_around(self.read_at_m(circumstances, place))


class Ball(StaticField):
    """Solid harmonics about a middle and in units of a reach, which stay as they are: of sources outside the ball."""

    def terms(self, degree: int) -> tuple[str, ...]:
        """Cosines and sines about the z axis."""
        return terms(degree)

    def shapes(self, extent: Extent) -> Quantities:
        """Middle and radius of the ball of reference, in the frame of the field."""
        middle = box(MIDDLE, "", "m", 100.0 * extent.reach_m, is_fixed=True)
        return (*middle, fixed("reach_m", "m", 0.0, 2.0 * extent.reach_m, POSITIVE))

    def around(self, places_m: Float[Tensor, "reading 3"]) -> dict[str, float]:
        """The ball about all places."""
        middle_m = places_m.mean(0)
        return ball(middle_m, max(float((places_m - middle_m).norm(dim=-1).max()), LEAST_REACH_M))

    def limit_around(self, places_m: Float[Tensor, "reading 3"]) -> Limit:
        """Highest degree with as many terms as there are places."""
        degrees, below = range(self.lowest, self.highest + 1), self.lowest**2
        return limit_of_places(places_m, {degree: (degree + 1) ** 2 - below for degree in degrees})

    def field(self, points_m: Points, theta: Theta) -> Field:
        """Field of sources outside the ball."""
        return harmonics.interior_field(in_reach(points_m, theta), self.amplitudes(theta))


def ball(middle_m: Tensor, reach_m: float) -> dict[str, float]:
    """Middle and reach as rig files hold them."""
    return written({**dict(zip(MIDDLE, middle_m.tolist(), strict=True)), "reach_m": reach_m})


def in_reach(points_m: Points, theta: Theta) -> Points:
    """Points about the middle, in units of the reach. Both are fixed, so alike in a batch."""
    return (points_m - constants(theta, MIDDLE)) / constant(theta, "reach_m")


class PerAmpereOfCoil(StaticField):
    """A field that goes with the current of a coil."""

    unit = "T/A"
    kind = Kind.COIL
    needs_winding = False

    def places(self, rig: Rig) -> tuple[str, ...]:
        """Coils with a winding of any shape."""
        return tuple(coil.name for coil in rig.wound)

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether the coil carried current."""
        return circumstances.has_current(place)

    def read_at_m(self, circumstances: Circumstances, place: str) -> Float[Tensor, "reading 3"]:
        """Positions of the readings with current in the coil, in m."""
        has_current = circumstances.current_A[:, circumstances.coil_number(place)] != 0.0
        return self.positions_m(circumstances, place)[has_current]

    @abstractmethod
    def positions_m(self, circumstances: Circumstances, place: str) -> Float[Tensor, "reading 3"]:
        """Positions of all readings, in the frame of the field."""


class OfCoil(PerAmpereOfCoil, SourceEffect):
    """A field that moves with a coil and is proportional to its current."""

    def positions_m(self, circumstances: Circumstances, place: str) -> Float[Tensor, "reading 3"]:
        """Positions of all readings in the frame of the coil."""
        return positions_m(circumstances, circumstances.rig.coils[circumstances.coil_number(place)])

    def apply(self, points_coil_m: Points, winding: AnyWinding, rule: Rule, theta: Theta) -> Field:
        """Field in the coil frame per ampere."""
        return self.field(points_coil_m, theta)


class OfRoom(StaticField, RoomEffect):
    """A field that stays in the room, without current."""

    is_background = True

    def limit(self, circumstances: Circumstances, place: str) -> Limit:
        """Highest degree that the places of the readings in the room determine; none where currents and coils' poses never changed."""
        words = _is_hidden(circumstances)
        return Limit(self.lowest - 1, words) if words else super().limit(circumstances, place)

    def read_at_m(self, circumstances: Circumstances, place: str) -> Float[Tensor, "reading 3"]:
        """Positions of all readings in the room, in m."""
        return positions_m(circumstances)

    def steady_T(self, points_m: Points, theta: Theta) -> Field:
        """Field in the world frame."""
        return self.field(points_m, theta)


class Answer(PerAmpereOfCoil, RoomEffect):
    """A field that stays in the room and answers the current of a coil."""

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether the coil carried current and is carried by a mover; of one that stands still, this is the coil's own field."""
        coil = circumstances.rig.coils[circumstances.coil_number(place)]
        return super().concerns(circumstances, place) and bool(coil.carried_by)

    def limit(self, circumstances: Circumstances, place: str) -> Limit:
        """Highest degree that the places of the readings in the room determine; at least the uniform part, for which one place is enough.

        The coil moved, so that its own field cannot be mistaken for it.
        """
        limit = super().limit(circumstances, place)
        return Limit(max(limit.degree, self.lowest), limit.words)

    def positions_m(self, circumstances: Circumstances, place: str) -> Float[Tensor, "reading 3"]:
        """Positions of all readings in the room."""
        return positions_m(circumstances)

    def response(self, per_ampere: PerAmpere, points_m: Points, theta: Theta) -> Field:
        """Field in the world frame per ampere."""
        return self.field(points_m, theta)


def _is_hidden(circumstances: Circumstances) -> str:
    """Why the room's field is taken for that of coils, and what to measure; empty where it is told from theirs, or no coil had current."""
    rig, current_A = circumstances.rig, circumstances.current_A
    steps_A = current_A.max(0).values - current_A.min(0).values
    is_steady = float(steps_A.max()) <= LEAST_STEP * circumstances.largest_current_A
    if is_steady and bool((current_A != 0.0).any()) and not any(coil.carried_by for coil in rig.coils):
        return "all readings are at one current, so the room's field is taken for the coil's; measure without current"
    return ""
