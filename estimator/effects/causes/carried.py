"""What a coil carries along besides its winding."""

from __future__ import annotations

from estimator.effects.base import Starts, Theta, box, triple, vector
from estimator.effects.circumstances import Circumstances
from estimator.effects.stages import Field, Points, SourceEffect
from estimator.field.dipole import dipole_field
from estimator.tensors import torch
from estimator.units import MU0_T_M_PER_A

FARTHEST_M = 0.15  # from the coil: what is farther off hardly shows, or does not move with it
BEHIND_M = (0.06, 0.12)
BESIDE_M = 0.03  # from the winding
MOMENT = ("moment_x", "moment_y", "moment_z")


def _about_the_winding(circumstances: Circumstances, place: str) -> Starts:
    """Behind the winding and on four sides of it."""
    radius_m = circumstances.rig.parameters[f"{place}.radius_m"].value
    aside_m = min(radius_m + BESIDE_M, FARTHEST_M)
    sides_m = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))
    beside = tuple({"x_m": aside_m * x, "y_m": aside_m * y, "z_m": -BESIDE_M} for x, y in sides_m)
    return (*({"x_m": 0.0, "y_m": 0.0, "z_m": -behind_m} for behind_m in BEHIND_M), *beside)


def _is_carried(circumstances: Circumstances, place: str) -> bool:
    """Whether the coil moves; beside one that stands still a magnet is a field of the room."""
    return any(coil.name == place and coil.carried_by is not None for coil in circumstances.rig.coils)


@SourceEffect.cause(
    quantities=(*triple(MOMENT, "_A_m2", "A m2", 0.3), *box("xyz", "_m", "m", FARTHEST_M)),
    starts=_about_the_winding,
    concerns=_is_carried,
    is_permanent=True,
)
def magnetised_link(points_coil_m: Points, theta: Theta) -> Field:
    """Something magnetised moves with the coil.

    Something on the coil's arm is magnetised: a dipole that moves with the coil, also while no current flows.

    Source: brakes and screws of an arm: a steel ball of 1 to 2 cm at 50 mT has 0.1 to 0.7 A m2.
    """
    from_dipole_m = points_coil_m - vector(theta, "xyz", "_m")
    return MU0_T_M_PER_A / (4.0 * torch.pi) * dipole_field(from_dipole_m, vector(theta, MOMENT, "_A_m2"))
