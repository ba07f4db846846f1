"""Corrections that are static fields, or uniform ones that change with time: of a coil, of the room, and what answers a coil."""

from __future__ import annotations

from jaxtyping import Float

from estimator.effects.base import Starts, Theta
from estimator.effects.circumstances import Circumstances
from estimator.effects.corrections.bases import Steps, Wanders
from estimator.effects.corrections.bore import Cylinder
from estimator.effects.corrections.correction import Limit, correction
from estimator.effects.corrections.static import Answer, Ball, OfCoil, OfRoom, ball, in_reach
from estimator.effects.corrections.targets import Room
from estimator.effects.stages import Field, Points
from estimator.field import harmonics
from estimator.tensors import Tensor

NEAREST = 0.5  # of the mean distance of the readings from a coil: nearer to it multipoles grow beyond what the others tell


@correction(OfCoil, Ball)
def coil_harmonics() -> None:
    """A smooth field that moves with the coil and goes with its current.

    What sources outside the readings' ball add to a coil: connections, iron, a winding that is built otherwise.
    """


class CoilMultipoles(OfCoil, Ball):
    """What sources inside a coil add to it, seen from outside: currents and magnetisation of another shape than a winding's.

    A dipole along the axis is nearly that of more turns, one across it a tilt, so multipoles begin with the quadrupole.
    """

    name = "coil_multipoles"
    words = "multipoles of the coil, which move with it and go with its current"
    lowest = 2

    def limit(self, circumstances: Circumstances, place: str) -> Limit:
        """Highest degree that the places of the readings in the coil's frame determine; none where some are much nearer to the coil."""
        distance_m = self._from_middle_m(circumstances, place).norm(dim=-1)
        if float(distance_m.min()) < NEAREST * float(distance_m.mean()):
            return Limit(self.lowest - 1, "readings reach into the coil, where multipoles have no meaning")
        return super().limit(circumstances, place)

    def starts(self, circumstances: Circumstances, place: str) -> Starts:
        """The ball about the middle of the winding that reaches to the nearest reading."""
        from_middle_m = self._from_middle_m(circumstances, place)
        middle_m = (self.read_at_m(circumstances, place) - from_middle_m)[0]
        return (ball(middle_m, float(from_middle_m.norm(dim=-1).min())),)

    def field(self, points_m: Points, theta: Theta) -> Field:
        """Field of sources inside the ball."""
        return harmonics.exterior_field(in_reach(points_m, theta), self.amplitudes(theta))

    def _from_middle_m(self, circumstances: Circumstances, place: str) -> Float[Tensor, "reading 3"]:
        """Positions of the readings with current in the coil, in m, along its axes from the middle of the winding.

        The middle lies half the winding's length behind the front face.
        """
        nominal = circumstances.rig.nominal_values()
        length_m = nominal[f"{place}.axial_pitch_m"] * nominal[f"{place}.axial_loops"]
        at_m = self.read_at_m(circumstances, place)
        return at_m + at_m.new_tensor([0.0, 0.0, 0.5 * length_m])


@correction(OfCoil, Cylinder)
def coil_bore() -> None:
    """A field along the bore that moves with the coil and goes with its current.

    What sources beside the places add to a coil: a winding of another shape than said, iron, leads.
    """


@correction(OfRoom, Ball)
def room_harmonics() -> None:
    """A smooth field that stays in the room.

    What sources outside the readings' ball add that stay in the room, without current.
    """


@correction(OfRoom, Cylinder)
def room_bore() -> None:
    """A field along the bore that stays in the room.

    What sources beside the places add without current: magnetised windings and steel.
    """


@correction(Answer, Ball)
def room_answers() -> None:
    """A smooth field that stays in the room and goes with the coil's current.

    What answers a coil's current and stays in the room: spare cable on the table, compensation of fields, iron, a return lead.
    """


@correction(Room, Wanders)
def room_wanders() -> None:
    """The field of the room wanders with time.

    The field of the room wanders smoothly, everywhere alike.
    """


@correction(Room, Steps, single="background_step")
def room_steps() -> None:
    """The field of the room jumps.

    The field of the room jumps, everywhere alike: something is brought near, or taken away.
    """
