"""What coils do to each other by force: mounts give way."""

from __future__ import annotations

from collections.abc import Mapping

from jaxtyping import Float

from estimator.effects.base import Kind, Theta, normal
from estimator.effects.causes.mount import shift
from estimator.effects.circumstances import Circumstances
from estimator.effects.declaring import cause
from estimator.effects.stages import Columns, MountEffect
from estimator.field.force import force_on_loop_N
from estimator.frames import Transform
from estimator.geometry.motion import base_from_motion, world_from_body
from estimator.rig.rig import Rig
from estimator.tensors import Tensor, torch


def _others_A(circumstances: Circumstances, place: str) -> Float[Tensor, "reading coil"]:
    """Product of this coil's current with that of each coil, in square amperes; none with itself."""
    current_A = circumstances.current_A
    own = circumstances.coil_number(place)
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


def _force_N(circumstances: Circumstances, body: str) -> Columns:
    """Force in newtons, in the frame of the coil."""
    rig, motion = circumstances.rig, circumstances.observations.motion
    values = {name: circumstances.current_A.new_tensor(value) for name, value in rig.nominal_values().items()}
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


def _round_coils(rig: Rig) -> tuple[str, ...]:
    """Every coil of a rig with several, all with round windings."""
    return tuple(coil.name for coil in rig.round) if len(rig.round) == len(rig.coils) > 1 else ()


@cause(
    MountEffect,
    name="coil_pulled",
    words="the coil gives way to the pull of other coils that carry current",
    source="a collaborative arm gives way by 10 to 100 micrometres under a newton, a printed bracket by half a millimetre",
    quantities=(normal("compliance_m_per_N", "m/N", 5e-4),),
    kind=Kind.COIL,
    places=_round_coils,
    # Another coil carried current at the same time.
    concerns=lambda circumstances, place: bool((_others_A(circumstances, place) != 0.0).any()),
    columns_of=_force_N,
    goes_with_current=True,
    is_linear=False,
    needs_winding=True,
    never_negative=("compliance_m_per_N",),
)
def coil_pulled(columns: Columns, theta: Theta) -> Transform:
    """Coils that carry current pull or push each other, and the mount of this one gives way.

    The shift is along the force, which is that of two circles at the nominal poses, and as large as the mount is soft.
    """
    return shift(theta["compliance_m_per_N"][..., None, None] * columns)
