"""Magnetisation of a superconductor's filaments: they screen changes of the field and keep what an earlier one has left."""

from __future__ import annotations

from dataclasses import fields
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from estimator.effects.base import Quantity, Theta, triple, vector
from estimator.effects.circumstances import Circumstances
from estimator.effects.stages import Currents, WindingMagnetisation
from estimator.field.magnetised import Rings, field_inside_per_ampere
from estimator.field.winding import Winding, winding_field_per_ampere
from estimator.field.winding_shape import Rule
from estimator.frames import Transform
from estimator.geometry.motion import pose_of
from estimator.rig.bodies import POSE_KEYS, Coil, MotionKind
from estimator.rig.parameters import Normal
from estimator.rig.rig import Rig
from estimator.tensors import Tensor, torch

LEFT = ("axial", "radial", "fan")  # what an earlier field leaves of itself
AZIMUTHS = 4  # of a ring, over which the field of another coil is averaged
SOURCE_RULE = Rule(64, 8, 7)
Numbers = tuple[float, ...]


def _described(rig: Rig, coil: Coil) -> Numbers:
    """Winding, and pose in the room or on the flange, as the rig file describes them; at no displacement for a mover that reports these."""
    nominal = rig.nominal_values()
    block = "world_from_coil" if coil.carried_by is None else "flange_from_coil"
    if coil.carried_by is not None and rig.mover(coil.carried_by).motion is MotionKind.DISPLACEMENT:
        block = "world_from_coil0"
    winding = (nominal[f"{coil.name}.{field.name}"] for field in fields(Winding))
    pose = (nominal[f"{coil.name}.{block}.{key}"] for key in POSE_KEYS)
    return (*winding, *pose)


@lru_cache(maxsize=256)
def _rings(target: Numbers, sources: tuple[Numbers | None, ...]) -> tuple[Rings, Tensor]:
    winding, pose = _winding(target), _pose(target)
    rings = Rings.of(winding)
    own_field = field_inside_per_ampere(winding, rings)
    patterns = []
    for source in sources:
        if source is None:
            patterns.append(torch.zeros_like(own_field))
        else:
            patterns.append(-own_field if source == target else -_from_coil(rings, pose, source))
    zeros, ones = torch.zeros_like(rings.height_m), torch.ones_like(rings.height_m)
    fanned = 1.0 + 2.0 * rings.height_m / winding.length_m
    left = [torch.stack(parts, dim=-1) for parts in ((zeros, ones), (ones, zeros), (fanned, zeros))]
    return rings, torch.stack((*patterns, *left))


def _from_coil(rings: Rings, pose: Transform, source: Numbers) -> Float[Tensor, "ring 2"]:
    """Field of one ampere in another coil, outwards and along the axis of the rings, averaged around them."""
    turn = 2.0 * torch.pi * torch.arange(AZIMUTHS, dtype=torch.float64) / AZIMUTHS
    outwards = torch.stack((torch.cos(turn), torch.sin(turn), torch.zeros_like(turn)), dim=-1)
    up = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    at_m = rings.radius_m[:, None, None] * outwards + rings.height_m[:, None, None] * up
    target_from_source = pose.inverse() @ _pose(source)
    points_m = target_from_source.inverse().apply(at_m.reshape(-1, 3))
    field = target_from_source.rotate(winding_field_per_ampere(points_m, _winding(source), SOURCE_RULE))
    field = field.reshape(at_m.shape)
    return torch.stack(((field * outwards).sum(-1).mean(-1), field[..., 2].mean(-1)), dim=-1)


def _winding(numbers: Numbers) -> Winding:
    return Winding(*torch.tensor(numbers[: -len(POSE_KEYS)], dtype=torch.float64))


def _pose(numbers: Numbers) -> Transform:
    pose = torch.tensor(numbers[-len(POSE_KEYS) :], dtype=torch.float64)
    return pose_of("coil", {f"coil.{key}": value for key, value in zip(POSE_KEYS, pose, strict=True)})


def _patterns(rig: Rig, coil: Coil) -> tuple[Rings, Float[Tensor, "pattern ring 2"]]:
    """Patterns: against one ampere in each coil that has a winding, along the axis, outwards, and fanned out."""
    sources = tuple(
        _described(rig, source) if isinstance(source, Coil) and source.carried_by == coil.carried_by else None
        for source in rig.coils
    )
    return _rings(_described(rig, coil), sources)


def _unscreened(circumstances: Circumstances) -> frozenset[str]:
    """The susceptibility, where no coil carries any current: then nothing is screened."""
    has_current = bool((circumstances.observations.history.current_A != 0.0).any())
    return frozenset(() if has_current else ("susceptibility",))


# Quantities: share of the present field that is turned against it; mu0 M that an earlier field has left. That is taken to first order
# along the winding: along the axis, outwards, and fanned out (outwards at the front face, inwards at the back).
@WindingMagnetisation.cause(
    "drives",
    quantities=(
        Quantity("susceptibility", "1", Normal(0.0, 0.3, lower=0.0, upper=1.0)),
        *triple(LEFT, "_T", "T", 0.02),
    ),
    places=lambda rig: tuple(coil.name for coil in rig.round if coil.is_superconducting),
    unseen=_unscreened,
    rings=_patterns,
)
def filament_magnetisation(current_A: Currents, theta: Theta) -> Float[Tensor, "*#batch reading pattern"]:
    """Currents that persist in the superconductor's filaments magnetise the winding.

    Persistent currents in a superconductor's filaments magnetise its winding: against the field, and as an earlier field has left it.

    The field is that of the windings as the rig file describes them, averaged around this one: its own, and those of coils that do
    not move relative to it.

    Source: Bean's model: 2/(3 pi) mu0 Jc d of the superconductor, 5 to 100 mT for filaments of 10 to 50 um below 1 T, times its share of
    the winding; twice that share answers a small change (Wilson, Superconducting Magnets, 1983, chapter 8).
    """
    # Screened current of each coil in A, then what an earlier field has left, in T.
    screened = theta["susceptibility"][..., None, None] * current_A
    left = vector(theta, LEFT, "_T")
    batch = np.broadcast_shapes(screened.shape[:-1], left.shape[:-1])
    return torch.cat((screened.expand(*batch, -1), left.expand(*batch, -1)), dim=-1)
