"""Real poses of a rig's bodies and real windings of its coils, at some values.

Effects of robot, mounts and windings act here, whoever asks for a pose or a winding: a fit, a prediction or a figure.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import overload

from estimator.effects.base import Effect
from estimator.effects.circumstances import Circumstances
from estimator.effects.stages import MotionEffect, MountEffect, SidesEffect, WindingEffect
from estimator.effects.use import uses_of
from estimator.field.coil import AnyWinding
from estimator.field.sided import SidedWinding
from estimator.field.winding import Winding
from estimator.frames import Transform
from estimator.geometry.motion import world_from_body as nominal_world_from_body
from estimator.rig.bodies import AnyCoil, Body, Coil, SidedCoil, WoundCoil
from estimator.rig.coordinates import Values
from estimator.rig.rig import Rig
from estimator.tensors import Tensor, torch

OF_LOOPS = ("axial_loops", "radial_loops", "axial_pitch_m", "radial_pitch_m")
WINDING_KEYS = ("radius_m", *OF_LOOPS)
CORNER = "inner_corner_radius_m"
SIDED_KEYS = ("inner_side_x_m", "inner_side_y_m", CORNER, *OF_LOOPS)


def columns_of(rig: Rig, circumstances: Circumstances) -> dict[str, Tensor]:
    """Inputs of effects that move bodies, besides the pose, by reading."""
    columns = {}
    nominal = rig.nominal_values()
    for use in uses_of(rig, Effect):
        if isinstance(use.effect, MotionEffect):
            columns[use.label] = use.effect.columns(circumstances, use.place)
        elif isinstance(use.effect, MountEffect):
            theta = {key: nominal[f"{use.label}.{key}"] for key in use.keys(rig)}
            columns[use.label] = use.effect.columns_of(circumstances, theta, use.place)
    return columns


def world_from_body(
    rig: Rig,
    body: Body,
    kind: str,
    flange: Mapping[str, Transform],
    values: Values,
    columns: Mapping[str, Tensor],
) -> Transform:
    """Pose of a coil or sensor with the effects of robot and mounts, given the recorded poses of the movers.

    Args:
        rig: Names the mover that carries the body, and the effects.
        body, kind: The body and its kind, `coil` or `sensor`.
        flange: Per mover base_from_flange, or the displacement in the end-effector frame (`base_from_motion`).
        values: Every number of the rig.
        columns: Per effect that moves bodies what else it depends on (`columns_of`).
    """
    moved = dict(flange)
    if body.carried_by is not None:
        for use in uses_of(rig, MotionEffect, body.carried_by):
            moved[use.place] = use.effect.apply(moved[use.place], columns[use.label], use.theta(values))
    at_reference, since = (mount_of(rig, body, values, columns, is_first) for is_first in (True, False))
    return nominal_world_from_body(rig, body, kind, moved, values, at_reference, since)


def mount_of(
    rig: Rig, body: Body, values: Values, columns: Mapping[str, Tensor], is_at_reference: bool
) -> Transform | None:
    """nominal_from_real of a body on its carrier, by the effects present at the reference pose or by those that came later.

    Returns: None where there is no such effect.
    """
    total = None
    for use in uses_of(rig, MountEffect, body.name):
        if use.effect.is_at_reference == is_at_reference:
            change = use.effect.apply(columns[use.label], use.theta(values))
            total = change if total is None else total @ change
    return total


def round_winding_of(rig: Rig, coil: AnyCoil, values: Values) -> Winding | None:
    """The coil's winding at these values where its loops are circles; None for any other coil."""
    return winding_of(rig, coil, values) if isinstance(coil, Coil) else None


@overload
def winding_of(rig: Rig, coil: Coil, values: Values) -> Winding: ...
@overload
def winding_of(rig: Rig, coil: SidedCoil, values: Values) -> SidedWinding: ...
@overload
def winding_of(rig: Rig, coil: WoundCoil, values: Values) -> AnyWinding: ...


def winding_of(rig: Rig, coil: WoundCoil, values: Values) -> AnyWinding:
    """The coil's winding at these values."""
    if isinstance(coil, SidedCoil):
        keys = tuple(key for key in SIDED_KEYS if coil.is_rounded or key != CORNER)
        of = {key: values[f"{coil.name}.{key}"] for key in keys}
        of.setdefault(CORNER, torch.zeros_like(of[SIDED_KEYS[0]]))
        sided = SidedWinding(coil.is_rounded, *torch.broadcast_tensors(*(of[key] for key in SIDED_KEYS)))
        for misstated in uses_of(rig, SidesEffect, coil.name):
            sided = misstated.effect.apply(sided, misstated.theta(values))
        return sided
    numbers = (values[f"{coil.name}.{key}"] for key in WINDING_KEYS)
    winding = Winding(*torch.broadcast_tensors(*numbers))
    for use in uses_of(rig, WindingEffect, coil.name):
        winding = use.effect.apply(winding, use.theta(values))
    return winding
