"""Corrections that are static magnetic fields: of sources about the readings or in a coil, moving with it or not."""

from __future__ import annotations

from typing import ClassVar

from jaxtyping import Float

from estimator.effects.base import Kind, Quantity, Theta, shape
from estimator.effects.circumstances import LEAST_STEP, Circumstances, Extent
from estimator.effects.corrections.correction import Correction, Limit, limit_of_places, positions_m
from estimator.effects.stages import PerAmpere, RoomEffect, SourceEffect
from estimator.field import harmonics
from estimator.field.coil import AnyWinding
from estimator.field.winding import Rule
from estimator.rig.harmonic_terms import terms
from estimator.rig.rig import Rig
from estimator.tensors import Tensor, torch

LEAST_REACH_M = 1e-6
NEAREST = 0.5  # of the mean distance of the readings from a coil: nearer to it multipoles grow beyond what the others tell


class _Harmonics(Correction):
    """A field without sources where it was read, about a middle and in units of a reach, which stay as they are."""

    def terms(self, degree: int) -> tuple[str, ...]:
        """Cosines and sines about the z axis."""
        return terms(degree)

    def shapes(self, extent: Extent) -> tuple[Quantity, ...]:
        """Middle and radius of the ball of reference, in the frame of the field."""
        ends_m = 100.0 * extent.reach_m
        return (
            *(shape(f"middle_{axis}_m", "m", -ends_m, ends_m, is_fixed=True) for axis in "xyz"),
            shape("reach_m", "m", 0.0, 2.0 * extent.reach_m, is_fixed=True),
        )

    @property
    def n_terms(self) -> dict[int, int]:
        """Number of terms up to each degree."""
        below = self.lowest**2
        return {degree: (degree + 1) ** 2 - below for degree in range(self.lowest, self.highest + 1)}

    def broken_rule(self, values: dict[str, float]) -> tuple[str, str] | None:  # type: ignore[override]
        """The reach must be a length."""
        return ("reach_m", "must be > 0") if values["reach_m"] <= 0.0 else None


def _in_reach(points_m: Float[Tensor, "*#batch point 3"], theta: Theta) -> Float[Tensor, "*batch point 3"]:
    """Points about the middle, in units of the reach. Both are fixed, so alike in a batch."""
    middle_m = torch.stack([theta[f"middle_{axis}_m"].flatten()[0] for axis in "xyz"])
    return (points_m - middle_m) / theta["reach_m"].flatten()[0]


def _ball(middle_m: Tensor, reach_m: float) -> dict[str, float]:
    """Middle and reach as rig files hold them."""
    numbers = {f"middle_{axis}_m": float(m) for axis, m in zip("xyz", middle_m, strict=True)} | {
        "reach_m": reach_m
    }
    return {key: float(f"{number:.6g}") for key, number in numbers.items()}


def _about(places_m: Float[Tensor, "reading 3"]) -> dict[str, float]:
    """The ball about all places."""
    middle_m = places_m.mean(0)
    return _ball(middle_m, max(float((places_m - middle_m).norm(dim=-1).max()), LEAST_REACH_M))


class CoilField(Correction, SourceEffect):
    """A field that moves with a coil and is proportional to its current."""

    unit: ClassVar[str] = "T/A"
    needs_winding: ClassVar[bool] = False

    def places(self, rig: Rig) -> tuple[str, ...]:
        """Coils with a winding of any shape."""
        return tuple(coil.name for coil in rig.wound)

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether the coil carried current."""
        return circumstances.has_current(place)

    @staticmethod
    def read_at_m(circumstances: Circumstances, place: str) -> Float[Tensor, "reading 3"]:
        """Positions of the readings with current in the coil, in the coil's frame, in m."""
        i = _index(circumstances, place)
        has_current = circumstances.current_A[:, i] != 0.0
        return positions_m(circumstances, circumstances.rig.coils[i])[has_current]


class CoilHarmonics(_Harmonics, CoilField):
    """What sources outside the readings' ball add to a coil: connections, iron, a winding that is built otherwise."""

    name: ClassVar[str] = "coil_harmonics"
    words: ClassVar[str] = "a smooth field that moves with the coil and goes with its current"

    def limit(self, circumstances: Circumstances, place: str) -> Limit:
        """Highest degree that the places of the readings in the coil's frame determine."""
        return limit_of_places(self.read_at_m(circumstances, place), self.n_terms)

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """The ball about the readings."""
        return (_about(self.read_at_m(circumstances, place)),)

    def apply(
        self, points_coil_m: Float[Tensor, "*#batch pose 3"], winding: AnyWinding, rule: Rule, theta: Theta
    ) -> Float[Tensor, "*#batch pose 3"]:
        """Field in the coil frame per ampere."""
        return harmonics.interior_field(_in_reach(points_coil_m, theta), self.amplitudes(theta))


class CoilMultipoles(_Harmonics, CoilField):
    """What sources inside a coil add to it, seen from outside: currents and magnetisation of another shape than a winding's.

    A dipole along the axis is nearly that of more turns, one across it a tilt, so multipoles begin with the quadrupole.
    """

    name: ClassVar[str] = "coil_multipoles"
    words: ClassVar[str] = "multipoles of the coil, which move with it and go with its current"
    lowest: ClassVar[int] = 2

    def limit(self, circumstances: Circumstances, place: str) -> Limit:
        """Highest degree that the places of the readings in the coil's frame determine; none where some are much nearer to the coil."""
        distance_m = self._from_middle_m(circumstances, place).norm(dim=-1)
        if float(distance_m.min()) < NEAREST * float(distance_m.mean()):
            return Limit(self.lowest - 1, "readings reach into the coil, where multipoles have no meaning")
        return limit_of_places(self.read_at_m(circumstances, place), self.n_terms)

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """The ball about the middle of the winding that reaches to the nearest reading."""
        from_middle_m = self._from_middle_m(circumstances, place)
        middle_m = (self.read_at_m(circumstances, place) - from_middle_m)[0]
        return (_ball(middle_m, float(from_middle_m.norm(dim=-1).min())),)

    def apply(
        self, points_coil_m: Float[Tensor, "*#batch pose 3"], winding: AnyWinding, rule: Rule, theta: Theta
    ) -> Float[Tensor, "*#batch pose 3"]:
        """Field in the coil frame per ampere."""
        return harmonics.exterior_field(_in_reach(points_coil_m, theta), self.amplitudes(theta))

    def _from_middle_m(self, circumstances: Circumstances, place: str) -> Float[Tensor, "reading 3"]:
        """Positions of the readings with current in the coil, in m, along its axes from the middle of the winding.

        The middle lies half the winding's length behind the front face.
        """
        nominal = circumstances.rig.nominal_values()
        length_m = nominal[f"{place}.axial_pitch_m"] * nominal[f"{place}.axial_loops"]
        at_m = self.read_at_m(circumstances, place)
        return at_m + at_m.new_tensor([0.0, 0.0, 0.5 * length_m])


class RoomHarmonics(_Harmonics, RoomEffect):
    """What sources outside the readings' ball add that stay in the room, without current."""

    name: ClassVar[str] = "room_harmonics"
    words: ClassVar[str] = "a smooth field that stays in the room"
    is_background: ClassVar[bool] = True

    def limit(self, circumstances: Circumstances, place: str) -> Limit:
        """Highest degree that the places of the readings in the room determine; none where currents and coils' poses never changed."""
        words = room_is_hidden(circumstances)
        if words:
            return Limit(self.lowest - 1, words)
        return limit_of_places(positions_m(circumstances), self.n_terms)

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """The ball about the readings."""
        return (_about(positions_m(circumstances)),)

    def steady_T(
        self, points_m: Float[Tensor, "*#batch pose 3"], theta: Theta
    ) -> Float[Tensor, "*#batch pose 3"]:
        """Field in the world frame."""
        return harmonics.interior_field(_in_reach(points_m, theta), self.amplitudes(theta))


class RoomAnswers(_Harmonics, RoomEffect):
    """What answers a coil's current and stays in the room: spare cable on the table, compensation of fields, iron, a return lead."""

    name: ClassVar[str] = "room_answers"
    kind: ClassVar[Kind] = Kind.COIL
    words: ClassVar[str] = "a smooth field that stays in the room and goes with the coil's current"
    unit: ClassVar[str] = "T/A"
    needs_winding: ClassVar[bool] = False

    def places(self, rig: Rig) -> tuple[str, ...]:
        """Coils with a winding of any shape."""
        return tuple(coil.name for coil in rig.wound)

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether the coil carried current and is carried by a mover; of one that stands still, this is the coil's own field."""
        coil = circumstances.rig.coils[_index(circumstances, place)]
        return circumstances.has_current(place) and bool(coil.carried_by)

    def limit(self, circumstances: Circumstances, place: str) -> Limit:
        """Highest degree that the places of the readings in the room determine; at least the uniform part, for which one place is enough.

        The coil moved, so that its own field cannot be mistaken for it.
        """
        limit = limit_of_places(self._read_at_m(circumstances, place), self.n_terms)
        return Limit(max(limit.degree, self.lowest), limit.words)

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """The ball about the readings."""
        return (_about(self._read_at_m(circumstances, place)),)

    def response(
        self, per_ampere: PerAmpere, points_m: Float[Tensor, "*#batch pose 3"], theta: Theta
    ) -> Float[Tensor, "*#batch pose 3"]:
        """Field in the world frame per ampere."""
        return harmonics.interior_field(_in_reach(points_m, theta), self.amplitudes(theta))

    @staticmethod
    def _read_at_m(circumstances: Circumstances, place: str) -> Float[Tensor, "reading 3"]:
        has_current = circumstances.current_A[:, _index(circumstances, place)] != 0.0
        return positions_m(circumstances)[has_current]


def room_is_hidden(circumstances: Circumstances) -> str:
    """Why the room's field is taken for that of coils, and what to measure; empty where it is told from theirs, or no coil had current."""
    rig, current_A = circumstances.rig, circumstances.current_A
    steps_A = current_A.max(0).values - current_A.min(0).values
    is_steady = float(steps_A.max()) <= LEAST_STEP * circumstances.largest_current_A
    if is_steady and bool((current_A != 0.0).any()) and not any(coil.carried_by for coil in rig.coils):
        return "all readings are at one current, so the room's field is taken for the coil's; measure without current"
    return ""


def _index(circumstances: Circumstances, place: str) -> int:
    return [coil.name for coil in circumstances.rig.coils].index(place)
