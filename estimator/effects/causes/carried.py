"""What a coil carries along besides its winding."""

from __future__ import annotations

from typing import ClassVar

from jaxtyping import Float

from estimator.effects.base import Quantity, Theta, shape, triple
from estimator.effects.circumstances import Circumstances, Extent
from estimator.effects.stages import SourceEffect
from estimator.field.winding import Rule, Winding
from estimator.tensors import Tensor, torch
from estimator.units import MU0_T_M_PER_A

FARTHEST_M = 0.15  # from the coil: what is farther off hardly shows, or does not move with it
BEHIND_M = (0.06, 0.12)
BESIDE_M = 0.03  # from the winding


class MagnetisedLink(SourceEffect):
    """Something on the coil's arm is magnetised: a dipole that moves with the coil, also while no current flows."""

    name: ClassVar[str] = "magnetised_link"
    words: ClassVar[str] = "something magnetised moves with the coil"
    source: ClassVar[str] = (
        "brakes and screws of an arm: a steel ball of 1 to 2 cm at 50 mT has 0.1 to 0.7 A m2"
    )
    is_permanent: ClassVar[bool] = True

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Moment and position in the coil frame."""
        moment = triple(("moment_x", "moment_y", "moment_z"), "_A_m2", "A m2", 0.3)
        return (*moment, *(shape(f"{axis}_m", "m", -FARTHEST_M, FARTHEST_M) for axis in "xyz"))

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Behind the winding and on four sides of it."""
        radius_m = circumstances.rig.parameters[f"{place}.radius_m"].value
        aside_m = min(radius_m + BESIDE_M, FARTHEST_M)
        sides_m = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))
        beside = tuple({"x_m": aside_m * x, "y_m": aside_m * y, "z_m": -BESIDE_M} for x, y in sides_m)
        return (*({"x_m": 0.0, "y_m": 0.0, "z_m": -behind_m} for behind_m in BEHIND_M), *beside)

    def apply(
        self, points_coil_m: Float[Tensor, "*#batch pose 3"], winding: Winding, rule: Rule, theta: Theta
    ) -> Float[Tensor, "*#batch pose 3"]:
        """Field of a point dipole (Jackson, section 5.6)."""
        moment_A_m2 = torch.stack([theta[f"moment_{axis}_A_m2"] for axis in "xyz"], dim=-1)[..., None, :]
        r = points_coil_m - torch.stack([theta[f"{axis}_m"] for axis in "xyz"], dim=-1)[..., None, :]
        r2 = (r**2).sum(-1, keepdim=True)
        along = (r * moment_A_m2).sum(-1, keepdim=True)
        return MU0_T_M_PER_A / (4.0 * torch.pi) * (3.0 * along * r - r2 * moment_A_m2) * r2**-2.5
