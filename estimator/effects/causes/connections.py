"""How coils are connected: exchanged with each other, or the other way round. Each mistake is present or absent."""

from __future__ import annotations

from itertools import combinations

from jaxtyping import Int

from estimator.effects.base import SIGN, Starts, Theta, switch, whole
from estimator.effects.circumstances import Circumstances
from estimator.effects.during import during, spell
from estimator.effects.stages import Current, CurrentEffect, Currents, OneCoilCurrent, RecordEffect
from estimator.tensors import Tensor, torch

MOST_BODIES = 1000.0
COILS_LATER = whole(
    "must be a whole number of coils, from 0", 0.0
)  # at which the other stands in the rig file
A_BODY = whole("must be the number of a body, from 1", 1.0)
TWO_BODIES = tuple(switch(key, 1.0, MOST_BODIES, 1.0, A_BODY) for key in ("first", "second"))
"""Two bodies, from 1 in the order of the rig file; a body exchanged with itself is where it should be."""


def pairs(n_bodies: int) -> Starts:
    """Every pair of so many bodies."""
    return tuple({"first": float(i), "second": float(j)} for i, j in combinations(range(1, n_bodies + 1), 2))


def exchanged(index: Int[Tensor, "*#batch row"], theta: Theta) -> Int[Tensor, "*#batch row"]:
    """Indices from 0 with the two bodies exchanged."""
    first, second = (theta[key][..., None].round().long() - 1 for key in ("first", "second"))
    return torch.where(index == first, second, torch.where(index == second, first, index))


def _of_others(current_A: Currents, source: Int[Tensor, "*#batch coil"]) -> Currents:
    """Current of another coil in each."""
    current_A, source = torch.broadcast_tensors(current_A, source[..., None, :])
    return current_A.gather(-1, source)


@RecordEffect.cause(
    "commanded_A",
    quantities=TWO_BODIES,
    places=lambda rig: ("record",) if len(rig.coils) > 1 else (),
    starts=lambda circumstances: pairs(len(circumstances.rig.coils)),
    is_structural=True,
    exchanges_coils=True,
)
def coils_exchanged(recorded_A: Currents, theta: Theta) -> Currents:
    """Two coils are connected in each other's place.

    The currents of two coils are exchanged.

    Source: any two coils.
    """
    index = torch.arange(recorded_A.shape[-1], device=recorded_A.device)
    return _of_others(recorded_A, exchanged(index, theta))


def _later_coils(circumstances: Circumstances, place: str) -> Starts:
    """Each of the coils that come later in the rig file."""
    n_later = len(circumstances.rig.coils) - 1 - circumstances.coil_number(place)
    return tuple({"later_by": float(n)} for n in range(1, n_later + 1))


@CurrentEffect.cause(
    quantities=(switch("later_by", 0.0, MOST_BODIES, 0.0, COILS_LATER),),
    places=lambda rig: tuple(coil.name for coil in rig.coils[:-1]),
    starts=_later_coils,
    is_record_mistake=True,
)
def _exchanged_with_a_later_one(current_A: Currents, theta: Theta, coil: int) -> Currents:
    """This coil and another are connected in each other's place.

    A coil and one that stands later in the rig file are connected in each other's place.

    Source: any two coils.
    """
    index = torch.arange(current_A.shape[-1], device=current_A.device)
    other = (coil + theta["later_by"][..., None].round().long()).clamp(max=len(index) - 1)
    return _of_others(current_A, torch.where(index == coil, other, torch.where(index == other, coil, index)))


@during(_exchanged_with_a_later_one, exchanges_coils=True)
def coils_exchanged_since() -> None:
    """From one instant on this coil and another are connected in each other's place.

    From one instant on two coils are connected in each other's place.
    """


# Quantities: of the delivered current over the commanded one.
@OneCoilCurrent.cause(
    quantities=(switch("sign", -1.0, 1.0, 1.0, SIGN),),
    starts=({"sign": -1.0},),
    is_structural=True,
    is_record_mistake=True,
)
def current_sign(current_A: Current, theta: Theta) -> Current:
    """The coil is connected the other way round.

    The leads of a coil are exchanged.

    Source: there or not.
    """
    return theta["sign"][..., None] * current_A


@during(current_sign)
def current_sign_since() -> None:
    """From one instant on the coil is connected the other way round.

    From one instant on the leads of a coil are exchanged.
    """


@spell(current_sign_since)
def current_sign_spell() -> None:
    """For a while the coil is connected the other way round.

    For a while the leads of a coil are exchanged, or its current is written with the other sign.
    """
