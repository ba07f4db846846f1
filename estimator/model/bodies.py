"""Where the bodies of a rig really stand, and what the coils really are, at some values.

Frames follow the movers and the mounting poses; effects of robot, mounts and windings act here, wherever the model, a prediction
or a picture asks for a pose or a winding.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from estimator.effects.base import Effect, MotionEffect, MountEffect, WindingEffect
from estimator.effects.circumstances import Circumstances
from estimator.effects.use import uses_of
from estimator.field.winding import Winding
from estimator.frames import Transform
from estimator.geometry.motion import pose_of
from estimator.rig.coordinates import Values
from estimator.rig.rig import Body, Coil, MotionKind, Rig

WINDING_KEYS = ("radius_m", "axial_loops", "radial_loops", "axial_pitch_m", "radial_pitch_m")


def columns_of(rig: Rig, circumstances: Circumstances) -> dict[str, Tensor]:
    """What the effects that move bodies depend on besides the pose, by reading."""
    found = {}
    nominal = rig.nominal_values()
    for use in uses_of(rig, Effect):
        if isinstance(use.effect, MotionEffect):
            found[use.label] = use.effect.columns(circumstances, use.place)
        elif isinstance(use.effect, MountEffect):
            own = {key: nominal[f"{use.label}.{key}"] for key in use.keys(rig)}
            found[use.label] = use.effect.columns(circumstances, own)
    return found


def world_from_body(
    rig: Rig,
    body: Body,
    kind: str,
    flange: Mapping[str, Transform],
    values: Values,
    columns: Mapping[str, Tensor] | None = None,
) -> Transform:
    """Pose of a coil or sensor, given where the movers stand.

    Args:
        rig: Names the mover that carries the body, and the effects of robot and mounts.
        body, kind: The body and its kind, `coil` or `sensor`.
        flange: Per mover base_from_flange, or the displacement in the end-effector frame (`base_from_motion`).
        values: Every number of the rig.
        columns: Per effect that moves bodies what else it depends on; without them the effects of robot and mounts are left out.
    References: Osinde et al., eq 14-22, with the frames of DESIGN section 2.
    """
    columns = columns or {}
    if body.carried_by is None:
        return pose_of(f"{body.name}.world_from_{kind}", values) @ _mount(rig, body, values, columns, False)
    mover = rig.mover(body.carried_by)
    moved = flange[mover.name]
    for use in uses_of(rig, MotionEffect, mover.name):
        if use.label in columns:
            moved = use.effect.apply(moved, columns[use.label], use.theta(values))
    at_reference = _mount(rig, body, values, columns, True)
    flange_from_body = pose_of(f"{body.name}.flange_from_{kind}", values) @ at_reference
    real = moved @ flange_from_body @ _mount(rig, body, values, columns, False)
    if mover.motion is MotionKind.DISPLACEMENT:
        return pose_of(f"{body.name}.world_from_{kind}0", values) @ flange_from_body.inverse() @ real
    return pose_of(f"{mover.name}.world_from_base", values) @ real


def static_columns(rig: Rig) -> dict[str, Tensor]:
    """Columns for one pose of those effects of robot and mounts that depend on the pose alone."""
    static = (MotionEffect.columns, MountEffect.columns)
    return {
        use.label: torch.zeros(1, 0, dtype=torch.float64)
        for use in uses_of(rig, Effect)
        if isinstance(use.effect, (MotionEffect, MountEffect)) and type(use.effect).columns in static
    }


def _mount(
    rig: Rig, body: Body, values: Values, columns: Mapping[str, Tensor], is_at_reference: bool
) -> Transform:
    """nominal_from_real of a body on what carries it, by the effects that were there already at the reference pose, or by the others."""
    total = Transform.identity()
    for use in uses_of(rig, MountEffect, body.name):
        if use.label in columns and use.effect.is_at_reference == is_at_reference:
            total = total @ use.effect.apply(columns[use.label], use.theta(values))
    return total


def winding_of(rig: Rig, coil: Coil, values: Values) -> Winding:
    """The coil's winding at these values."""
    numbers = (values[f"{coil.name}.{key}"] for key in WINDING_KEYS)
    winding = Winding(*torch.broadcast_tensors(*numbers))
    for use in uses_of(rig, WindingEffect, coil.name):
        winding = use.effect.apply(winding, use.theta(values))
    return winding
