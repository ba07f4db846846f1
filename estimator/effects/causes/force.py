"""What coils do to each other by force: mounts give way."""

from __future__ import annotations

from jaxtyping import Float

from estimator.effects.base import Kind, Theta, normal
from estimator.effects.causes.mount import shift
from estimator.effects.circumstances import Circumstances
from estimator.effects.stages import Columns, MountEffect
from estimator.field.force import force_on_loop_N
from estimator.frames import Transform
from estimator.rig.rig import Rig
from estimator.tensors import Tensor, torch


def _others_A(circumstances: Circumstances, place: str) -> Float[Tensor, "reading coil"]:
    """Product of this coil's current with that of each coil, in square amperes; none with itself."""
    current_A = circumstances.current_A
    own = circumstances.coil_number(place)
    is_other = (torch.arange(current_A.shape[1], device=current_A.device) != own).to(current_A)
    return current_A[:, own, None] * current_A * is_other


def _loop(circumstances: Circumstances, coil: str) -> tuple[Tensor, Tensor, float]:
    """Middle of a winding, which lies behind its front face, in the frame of the coil, its mean radius, and its turns."""
    radius_m, bore_m, length_m = circumstances.winding_m(coil)
    nominal, like = circumstances.rig.nominal_values(), circumstances.current_A.new_tensor
    turns = nominal[f"{coil}.axial_loops"] * nominal[f"{coil}.radial_loops"]
    return like((0.0, 0.0, -0.5 * length_m)), like(0.5 * (radius_m + bore_m)), turns


def _force_N(circumstances: Circumstances, body: str) -> Columns:
    """Force in newtons, in the frame of the coil."""
    coils = circumstances.rig.coils
    own_from_world = circumstances.world_from(coils[circumstances.coil_number(body)]).inverse()
    own_middle_m, own_radius_m, own_turns = _loop(circumstances, body)
    total = circumstances.current_A.new_zeros(len(circumstances), 3)
    for i, coil in enumerate(coils):
        if coil.name == body:
            continue
        own_from_coil = own_from_world @ circumstances.world_from(coil)
        middle_m, radius_m, turns = _loop(circumstances, coil.name)
        at_m = own_from_coil.apply(middle_m) - own_middle_m
        by_turns_N = force_on_loop_N((at_m, own_from_coil.rotation), own_radius_m, radius_m)
        total = total + own_turns * turns * _others_A(circumstances, body)[:, i, None] * by_turns_N
    return total


def _round_coils(rig: Rig) -> tuple[str, ...]:
    """Every coil of a rig with several, all with round windings."""
    return tuple(coil.name for coil in rig.round) if len(rig.round) == len(rig.coils) > 1 else ()


@MountEffect.cause(
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
    """The coil gives way to the pull of other coils that carry current.

    Coils that carry current pull or push each other, and the mount of this one gives way.

    The shift is along the force, which is that of two circles at the nominal poses, and as large as the mount is soft.

    Source: a collaborative arm gives way by 10 to 100 micrometres under a newton, a printed bracket by half a millimetre.
    """
    return shift(theta["compliance_m_per_N"][..., None, None] * columns)
