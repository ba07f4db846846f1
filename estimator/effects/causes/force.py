"""What coils do to each other by force: mounts give way."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from jaxtyping import Float

from estimator.effects.base import Kind, Quantity, Theta, normal
from estimator.effects.circumstances import Circumstances, Extent
from estimator.effects.stages import MountEffect
from estimator.field.force import force_on_loop_N
from estimator.frames import Transform
from estimator.geometry.motion import base_from_motion, world_from_body
from estimator.rig.rig import Rig
from estimator.tensors import Tensor, torch


class CoilPulled(MountEffect):
    """Coils that carry current pull or push each other, and the mount of this one gives way.

    The shift is along the force, which is that of two circles at the nominal poses, and as large as the mount is soft.
    """

    name: ClassVar[str] = "coil_pulled"
    is_at_reference: ClassVar[bool] = False
    kind: ClassVar[Kind] = Kind.COIL
    words: ClassVar[str] = "the coil gives way to the pull of other coils that carry current"
    source: ClassVar[str] = (
        "a collaborative arm gives way by 10 to 100 micrometres under a newton, a printed bracket by half a millimetre"
    )
    goes_with_current: ClassVar[bool] = True
    is_linear: ClassVar[bool] = False
    needs_winding: ClassVar[bool] = True
    never_negative: ClassVar[tuple[str, ...]] = ("compliance_m_per_N",)

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Shift per force."""
        return (normal("compliance_m_per_N", "m/N", 5e-4),)

    def places(self, rig: Rig) -> tuple[str, ...]:
        """Every coil of a rig with several, all with round windings."""
        return super().places(rig) if len(rig.round) == len(rig.coils) > 1 else ()

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether another coil carried current at the same time as this one."""
        return bool((_others_A(circumstances, place) != 0.0).any())

    def columns_of(
        self, circumstances: Circumstances, theta: Mapping[str, float], body: str
    ) -> Float[Tensor, "reading column"]:
        """Force in newtons, in the frame of the coil."""
        rig, motion = circumstances.rig, circumstances.observations.motion
        values = {
            name: circumstances.current_A.new_tensor(value) for name, value in rig.nominal_values().items()
        }
        flange = {mover.name: base_from_motion(mover, motion[mover.name]) for mover in rig.movers}
        world_from = {coil.name: world_from_body(rig, coil, "coil", flange, values) for coil in rig.coils}
        own = world_from[body].inverse()
        total = circumstances.current_A.new_zeros(len(circumstances), 3)
        for i, coil in enumerate(rig.coils):
            if coil.name == body:
                continue
            seen = own @ world_from[coil.name]
            middle_m = seen.apply(_middle_m(values, coil.name)) - _middle_m(values, body)
            radii_m = (_radius_m(values, body), _radius_m(values, coil.name))
            by_turns_N = force_on_loop_N((middle_m, seen.rotation), *radii_m)
            turns = _turns(values, body) * _turns(values, coil.name)
            total = total + turns * _others_A(circumstances, body)[:, i, None] * by_turns_N
        return total

    def apply(self, columns: Float[Tensor, "*#batch pose column"], theta: Theta) -> Transform:
        """nominal_from_real of the coil."""
        shift = theta["compliance_m_per_N"][..., None, None] * columns
        return Transform(torch.eye(3, dtype=shift.dtype, device=shift.device).expand(1, 3, 3), shift)


def _others_A(circumstances: Circumstances, place: str) -> Float[Tensor, "reading coil"]:
    """Product of this coil's current with that of each coil, in square amperes; none with itself."""
    current_A = circumstances.current_A
    own = [coil.name for coil in circumstances.rig.coils].index(place)
    is_other = (torch.arange(current_A.shape[1], device=current_A.device) != own).to(current_A)
    return current_A[:, own, None] * current_A * is_other


def _radius_m(values: Mapping[str, Tensor], coil: str) -> Tensor:
    """Radius of the mean loop."""
    thickness_m = values[f"{coil}.radial_pitch_m"] * values[f"{coil}.radial_loops"]
    return values[f"{coil}.radius_m"] - 0.5 * thickness_m


def _middle_m(values: Mapping[str, Tensor], coil: str) -> Tensor:
    """Middle of the winding, which lies behind its front face, in the frame of the coil."""
    length_m = values[f"{coil}.axial_pitch_m"] * values[f"{coil}.axial_loops"]
    zero = torch.zeros_like(length_m)
    return torch.stack((zero, zero, -0.5 * length_m))


def _turns(values: Mapping[str, Tensor], coil: str) -> Tensor:
    return values[f"{coil}.axial_loops"] * values[f"{coil}.radial_loops"]
