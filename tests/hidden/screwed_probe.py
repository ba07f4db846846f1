"""A steel screw in the holder of a probe, which the field of two coils magnetises; the rig file knows of none."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tests.hidden.causes.surroundings import dipole_field
from tests.hidden.coil import MU0
from tests.hidden.protocols import Array
from tests.hidden.pulled_pair import PulledPair


@dataclass(frozen=True)
class ScrewedProbe:
    """The truth.

    Attributes:
        pair: The coils, whose brackets may be stiff.
        place_m: Place of the screw in the frame of the probe, which does not turn.
        radius_m: Of a soft sphere that answers alike.
    """

    pair: PulledPair
    place_m: Array
    radius_m: float

    def field_T(self, currents_A: Array, at_m: Array) -> Array:
        """What the probe sees at points: the coils, and the screw beside it."""
        there_T = self.pair.field_T(currents_A, at_m + self.place_m)
        moment_A_m2 = 4.0 * np.pi * self.radius_m**3 / MU0 * there_T
        away_m = np.broadcast_to(-self.place_m, at_m.shape)
        return np.asarray(self.pair.field_T(currents_A, at_m) + dipole_field(away_m, moment_A_m2))
