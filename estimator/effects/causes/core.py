"""An iron core that answers every coil, and what it keeps of earlier currents."""

from __future__ import annotations

from typing import ClassVar

from jaxtyping import Float

from estimator.effects.base import Quantity, Theta, at_least_zero
from estimator.effects.circumstances import Circumstances, Extent
from estimator.effects.stages import CoreMagnetisation, CoreMemory
from estimator.field.core import Core
from estimator.field.saturation import played
from estimator.rig.parameters import LogNormal, Normal
from estimator.rig.rig import Cause, Rig
from estimator.tensors import Tensor

USUAL_STRENGTH = 0.95  # a susceptibility of 380: fits begin at iron, for little of it looks otherwise
# Radius in radii of the bore, length in those of the winding, front face before that of the winding in its lengths.
SHAPES = ((0.9, 1.0, 0.0), (0.7, 1.4, 0.1))


class CrossMagnetisation(CoreMagnetisation):
    """A coil has an iron core, which its own current magnetises, and so do the other coils and their cores.

    It is a cylinder about the coil's axis. A rig file that knows it states its sizes; a strength of 0.96 is a susceptibility of 500.
    """

    name: ClassVar[str] = "cross_magnetisation"
    words: ClassVar[str] = "the coil has an iron core, which the other coils magnetise too"
    source: ClassVar[str] = (
        "soft iron and steel: susceptibility 100 to 10000, saturation 1.6 to 2.2 T (Bozorth, Ferromagnetism, 1951); sizes wide"
    )
    is_structural: ClassVar[bool] = True

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Strength (0 no iron, 1 unlimited permeability); sizes, place of the front face, and polarisation when saturated."""
        return (
            Quantity("strength", "1", Normal(0.0, 0.5, lower=0.0, upper=1.0)),
            Quantity("radius_m", "m", LogNormal(0.01, 0.7), 0.01, is_shape=True),
            Quantity("length_m", "m", LogNormal(0.06, 0.7), 0.06, is_shape=True),
            Quantity("front_m", "m", Normal(0.0, 0.02), 0.0, is_shape=True),
            Quantity("saturation_T", "T", LogNormal(1.9, 0.25), 1.9, is_shape=True),
        )

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether another coil carries current; one coil alone cannot show more than `iron_core` and `core_saturation` say."""
        coil = [coil.name for coil in circumstances.rig.coils].index(place)
        is_on = (circumstances.observations.history.current_A != 0.0).any(0)
        is_on[coil] = False
        return bool(is_on.any())

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Cores that fill the bore more or less, as long as the winding or longer."""
        nominal = circumstances.rig.nominal_values()
        radius_m, axial, radial, axial_pitch_m, radial_pitch_m = (
            nominal[f"{place}.{key}"]
            for key in ("radius_m", "axial_loops", "radial_loops", "axial_pitch_m", "radial_pitch_m")
        )
        bore_m, winding_m = radius_m - radial * radial_pitch_m, axial * axial_pitch_m
        return tuple(
            {
                "strength": USUAL_STRENGTH,
                "radius_m": filled * bore_m,
                "length_m": length * winding_m,
                "front_m": before * winding_m,
            }
            for filled, length, before in SHAPES
        )

    def core(self, theta: Theta) -> Core:
        """The cylinder and its iron."""
        return Core(**theta)


class CoreRemanence(CoreMemory):
    """The core lags behind its coil's current by a play: it stays magnetised when the current is switched off.

    The play is that of the coil's own current; what other coils did before is left out.
    """

    name: ClassVar[str] = "core_remanence"
    words: ClassVar[str] = "the iron core lags behind the current and stays magnetised without"
    source: ClassVar[str] = "coercivity 10 to 1000 A/m of soft iron and steel, over 1e4 turns per metre"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Half the play of the core's memory, as a current in A."""
        return (at_least_zero("coercive_A", "A", max(0.02, 0.02 * extent.largest_current_A)),)

    def places(self, rig: Rig) -> tuple[str, ...]:
        """Coils that may have a core."""
        return tuple(coil.name for coil in rig.round)

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether the rig has an iron core here already, and the current of the coil has turned back."""
        if Cause(CrossMagnetisation.name, place) not in circumstances.rig.effects:
            return False
        coil = [coil.name for coil in circumstances.rig.coils].index(place)
        return bool(circumstances.last_turn_A(coil).any())

    def beyond_the_moment(self, key: str) -> str | None:
        """The way to a current is history."""
        return "which current flowed before"

    def lag_A(self, theta: Theta, circumstances: Circumstances, coil: int) -> Float[Tensor, "*batch reading"]:
        """The play's current less the coil's."""
        history_A = circumstances.observations.history.current_A[:, coil]
        lag_A = played(history_A, theta["coercive_A"]) - history_A
        return lag_A[..., circumstances.observations.row]
