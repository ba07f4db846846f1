"""An iron core that answers every coil, and what it keeps of earlier currents."""

from __future__ import annotations

from estimator.effects.base import Quantity, Starts, Theta, at_least_zero
from estimator.effects.circumstances import Circumstances
from estimator.effects.stages import CoreMagnetisation, CoreMemory, Current
from estimator.field.core import Core
from estimator.field.saturation import played
from estimator.rig.parameters import LogNormal, Normal
from estimator.rig.rig import Cause

USUAL_STRENGTH = 0.95  # a susceptibility of 380: fits begin at iron, for little of it looks otherwise
# Radius in radii of the bore, length in those of the winding, front face before that of the winding in its lengths.
SHAPES = ((0.9, 1.0, 0.0), (0.7, 1.4, 0.1))


def _is_magnetised_by_another(circumstances: Circumstances, place: str) -> bool:
    """Whether iron could be in the bore and another coil carries current; one alone shows no more than `iron_core` does."""
    if circumstances.has_sensor_in_bore(place):
        return False
    others = (coil.name for coil in circumstances.rig.coils if coil.name != place)
    return any(bool(circumstances.commanded_A(coil).any()) for coil in others)


def _in_the_bore(circumstances: Circumstances, place: str) -> Starts:
    """Cores that fill the bore more or less, as long as the winding or longer."""
    _, bore_m, winding_m = circumstances.winding_m(place)
    return tuple(
        {
            "strength": USUAL_STRENGTH,
            "radius_m": filled * bore_m,
            "length_m": length * winding_m,
            "front_m": before * winding_m,
        }
        for filled, length, before in SHAPES
    )


# Quantities: strength (0 no iron, 1 unlimited permeability); sizes, place of the front face, and polarisation when saturated.
@CoreMagnetisation.cause(
    quantities=(
        Quantity("strength", "1", Normal(0.0, 0.5, lower=0.0, upper=1.0)),
        Quantity("radius_m", "m", LogNormal(0.01, 0.7), 0.01, is_shape=True),
        Quantity("length_m", "m", LogNormal(0.06, 0.7), 0.06, is_shape=True),
        Quantity("front_m", "m", Normal(0.0, 0.02), 0.0, is_shape=True),
        Quantity("saturation_T", "T", LogNormal(1.9, 0.25), 1.9, is_shape=True),
    ),
    concerns=_is_magnetised_by_another,
    starts=_in_the_bore,
    is_structural=True,
)
def cross_magnetisation(theta: Theta) -> Core:
    """The coil has an iron core, which the other coils magnetise too.

    A coil has an iron core, which its own current magnetises, and so do the other coils and their cores.

    It is a cylinder about the coil's axis. A rig file that knows it states its sizes; a strength of 0.96 is a susceptibility of 500.

    Source: soft iron and steel: susceptibility 100 to 10000, saturation 1.6 to 2.2 T (Bozorth, Ferromagnetism, 1951); sizes wide.
    """
    return Core(**theta)


def _has_core_that_remembers(circumstances: Circumstances, place: str) -> bool:
    """Whether the rig has an iron core here already, and the current of the coil has turned back."""
    has_core = Cause(cross_magnetisation.name, place) in circumstances.rig.effects
    return has_core and circumstances.has_turned_back(place)


# Quantities: half the play of the core's memory, as a current.
@CoreMemory.cause(
    quantities=lambda extent: (at_least_zero("coercive_A", "A", max(0.02, 0.02 * extent.largest_current_A)),),
    concerns=_has_core_that_remembers,
    depends_on="which current flowed before",
)
def core_remanence(theta: Theta, circumstances: Circumstances, coil: int) -> Current:
    """The iron core lags behind the current and stays magnetised without.

    The core lags behind its coil's current by a play: it stays magnetised when the current is switched off.

    The play is that of the coil's own current; what other coils did before is left out.

    Source: coercivity 10 to 1000 A/m of soft iron and steel, over 1e4 turns per metre.
    """
    history_A = circumstances.observations.history.current_A[:, coil]
    lag_A = played(history_A, theta["coercive_A"]) - history_A
    return lag_A[..., circumstances.observations.row]
