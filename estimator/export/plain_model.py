"""A calibrated model as a short list of numbers that other programs can evaluate: windings, poses, currents and a uniform field.

A rig may have effects that such a list has no place for, like iron in the room. Then `plain_model` says which, and nothing is exported.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

from jaxtyping import Float

from estimator.effects.base import Effect
from estimator.effects.stages import (
    CoreMagnetisation,
    CoreMemory,
    CurrentEffect,
    MotionEffect,
    MountEffect,
    RoomEffect,
    SourceEffect,
    WindingMagnetisation,
)
from estimator.effects.use import uses_of
from estimator.errors import InvalidInput
from estimator.field.coil import AnyWinding
from estimator.field.quadrature import DiscreteRule, discrete_gauss
from estimator.field.winding_shape import DEFAULT_TOLERANCE
from estimator.field.zones import rules_by_level
from estimator.frames import Transform, rotation_from_vector
from estimator.geometry.motion import ends_of, pose_of
from estimator.model.bodies import mount_of, winding_of
from estimator.model.room_field import at_one_moment
from estimator.model.sources import Sources
from estimator.rig.arms import DenavitHartenberg
from estimator.rig.bodies import (
    Body,
    DisplacementFrame,
    FieldSum,
    MotionKind,
    Mover,
    Point,
    SidedCoil,
    WoundCoil,
)
from estimator.rig.coordinates import Values
from estimator.rig.rig import Rig
from estimator.tensors import Tensor, torch

PROBES_A = (1.0, -3.0, 7.0)  # currents at which a supply shows whether it is linear
# Points at which a room shows whether it is uniform.
PROBE_POINTS_M = ((0.0, 0.0, 0.0), (0.3, -0.2, 0.1), (-0.05, 0.4, -0.3))
GRID_FORMATS = "csv, vtk and openpmd"  # hold a field on a grid, whatever makes it


@dataclass(frozen=True)
class NodeRule:
    """Weighted loops that stand for those of a winding.

    Attributes:
        axial, radial: Nodes in pitches about the middle of the winding, and weights.
        steps: AGM steps of each round loop, points along each arc of others.
    """

    axial: DiscreteRule
    radial: DiscreteRule
    steps: int


@dataclass(frozen=True)
class PlainCoil:
    """A winding on its carrier: `world_from_coil = world_from_base @ (pose of the mover) @ flange_from_coil`.

    Attributes:
        name: As in the rig.
        winding: Its geometry, no batch.
        mover: Number of the mover that carries it; -1 where none does.
        world_from_base, flange_from_coil: Poses; the second one is no motion where nothing carries the coil.
        first_level: Level of distance to which the first entry of `rule_of_level` belongs.
        rule_of_level: Number of the rule by level; a distance d has the level floor(2 log2 d).
        rules: Each rule once.
        leads: Ends of the straight wires that bring its current and take it away, in the frame of the coil and the order of the current.
    """

    name: str
    winding: AnyWinding
    mover: int
    world_from_base: Transform
    flange_from_coil: Transform
    first_level: int
    rule_of_level: tuple[int, ...]
    rules: tuple[NodeRule, ...]
    leads: tuple[tuple[Point, Point], ...] = ()


@dataclass(frozen=True)
class PlainMover:
    """What carries coils.

    Attributes:
        name, columns: Its name, and names of the six numbers of its motion.
        joints: Denavit-Hartenberg table where the six numbers are joint angles; None where they are position and rotation vector.
    """

    name: str
    columns: tuple[str, ...]
    joints: DenavitHartenberg | None


@dataclass(frozen=True)
class PlainModel:
    """Coils, movers, supplies and the uniform field of the room at the maximum of the posterior.

    Attributes:
        name: Of the rig.
        coils, movers: In the order of currents and motions.
        delivered_A_per_A: Delivered current of each coil per commanded ampere in each; a row for each coil.
        offset_A: Current that each coil gets without a command.
        background_T: Field without any current, in the world frame.
    """

    name: str
    coils: tuple[PlainCoil, ...]
    movers: tuple[PlainMover, ...]
    delivered_A_per_A: Float[Tensor, "coil coil"]
    offset_A: Float[Tensor, " coil"]
    background_T: Float[Tensor, " 3"]


def plain_model(rig: Rig, values: Values, to: str, only_round: bool = False) -> PlainModel:
    """The model of a rig in plain numbers, which predicts what `RoomField` predicts.

    Args:
        rig: Coils, movers and effects.
        values: Every number of the rig, no batch.
        to: What is exported to, for the message.
        only_round: It can express neither windings with straight sides nor leads.
    Raises:
        InvalidInput: The rig has something that the numbers cannot express; the message names it.
    """
    sources = at_one_moment(rig)
    missing = [*_inexpressible(rig, only_round), *_bent(rig, sources, values), *_uneven(rig, values)]
    if missing:
        raise InvalidInput(
            f"export to {to} must express the whole model; it has no place for {', '.join(missing)} of rig {rig.name!r} "
            f"({GRID_FORMATS} hold any field on a grid)"
        )
    carriers = [mover for mover in rig.movers if mover.name in {coil.carried_by for coil in rig.coils}]
    return PlainModel(
        rig.name,
        tuple(_coil(rig, coil, sources, values, carriers) for coil in rig.wound),
        tuple(PlainMover(mover.name, mover.columns, mover.table) for mover in carriers),
        *supply_of(rig, sources, values),
        background_of(rig, sources, values),
    )


def poses_of(
    rig: Rig, body: Body, sources: Sources, values: Values, kind: str = "coil"
) -> tuple[Transform, Transform]:
    """`world_from_base` and `flange_from_coil` of a coil, as `PlainCoil` has them, or those of a sensor; differentiable in the values."""
    at_reference, since = (
        mount_of(rig, body, values, sources.columns, is_first) or Transform.identity()
        for is_first in (True, False)
    )
    if body.carried_by is None:
        return _alone(pose_of(f"{body.name}.world_from_{kind}", values) @ since), Transform.identity()
    mover = rig.mover(body.carried_by)
    flange_from_body = pose_of(f"{body.name}.flange_from_{kind}", values) @ at_reference
    if mover.motion is not MotionKind.DISPLACEMENT:
        base_from_first, last_from_flange = ends_of(mover, torch.zeros(6, dtype=torch.float64))
        base = pose_of(f"{mover.name}.world_from_base", values) @ base_from_first
        return _alone(base), _alone(last_from_flange @ flange_from_body @ since)
    base = pose_of(f"{body.name}.world_from_{kind}0", values) @ flange_from_body.inverse()
    return _alone(base @ _flange_from_report(mover)), _alone(
        _flange_from_report(mover).inverse() @ flange_from_body @ since
    )


def supply_of(rig: Rig, sources: Sources, values: Values) -> tuple[Tensor, Tensor]:
    """Delivered current per commanded ampere, and the one without a command; differentiable in the values."""
    n = len(rig.coils)
    steps_A = torch.cat((torch.zeros(1, n), torch.eye(n))).to(torch.float64)
    delivered_A = sources.delivered_A(steps_A[:, None], values)[:, 0]
    return (delivered_A[1:] - delivered_A[0]).T, delivered_A[0]


def background_of(rig: Rig, sources: Sources, values: Values) -> Float[Tensor, " 3"]:
    """Field of the room without current; differentiable in the values."""
    return _background(rig, sources, values)[0]


def numbers_of(winding: AnyWinding) -> dict[str, Tensor]:
    """The numbers of a winding by their names."""
    names = (item.name for item in fields(winding))
    return {name: getattr(winding, name) for name in names if name != "is_rounded"}


def _inexpressible(rig: Rig, only_round: bool) -> list[str]:
    """Coils and effects that never have a place."""
    missing = [f"{coil.name} (a coil without a winding)" for coil in rig.unwound]
    if only_round:
        missing += [f"{coil.name} (leads)" for coil in rig.wound if coil.leads is not None]
        missing += [
            f"{c.name} (a winding with straight sides)" for c in rig.wound if isinstance(c, SidedCoil)
        ]
    missing += [
        f"{c.name} (field_sum of the paper)" for c in rig.round if c.field_sum is not FieldSum.VECTORS
    ]
    carriers = {coil.carried_by for coil in rig.coils}
    coil_names = {coil.name for coil in rig.coils}
    zero = at_one_moment(rig).columns
    for use in uses_of(rig, Effect):
        effect = use.effect
        is_source = isinstance(effect, SourceEffect | WindingMagnetisation | CoreMagnetisation | CoreMemory)
        is_response = isinstance(effect, RoomEffect) and type(effect).response is not RoomEffect.response
        is_on_the_way = isinstance(effect, MotionEffect) and use.place in carriers
        is_loose = (
            isinstance(effect, MountEffect) and use.place in coil_names and zero[use.label].shape[-1] > 0
        )
        if is_source or is_response or is_on_the_way or is_loose:
            missing.append(use.label)
    return missing


def _bent(rig: Rig, sources: Sources, values: Values) -> list[str]:
    """Effects of supplies, if what is delivered is not a straight line of what is commanded."""
    matrix, offset_A = supply_of(rig, sources, values)
    commanded_A = torch.tensor(PROBES_A, dtype=torch.float64)[:, None].expand(-1, len(rig.coils))
    commanded_A = commanded_A * torch.arange(1, len(rig.coils) + 1)
    delivered_A = sources.delivered_A(commanded_A[:, None], values)[:, 0]
    if torch.allclose(delivered_A, commanded_A @ matrix.T + offset_A, rtol=1e-12, atol=1e-12):
        return []
    return [use.label for use in uses_of(rig, CurrentEffect)]


def _uneven(rig: Rig, values: Values) -> list[str]:
    """Effects of the room whose field without current differs from point to point."""
    sources = at_one_moment(rig, len(PROBE_POINTS_M))
    field_T = _background(rig, sources, values, PROBE_POINTS_M)
    if torch.equal(field_T, field_T[:1].expand_as(field_T)):
        return []
    return [use.label for use in uses_of(rig, RoomEffect)]


def _background(
    rig: Rig, sources: Sources, values: Values, points: tuple[tuple[float, ...], ...] = ((0.0, 0.0, 0.0),)
) -> Float[Tensor, "point 3"]:
    points_m = torch.tensor(points, dtype=torch.float64)
    total_T = torch.zeros_like(points_m)
    for use in uses_of(rig, RoomEffect):
        theta = use.theta(values)
        parts = (use.effect.steady_T(points_m, theta), use.effect.drifting_T(theta, sources.circumstances))
        total_T = sum((part for part in parts if part is not None), start=total_T)
    return total_T


def _coil(rig: Rig, coil: WoundCoil, sources: Sources, values: Values, carriers: list[Mover]) -> PlainCoil:
    winding = winding_of(rig, coil, values)
    first_level, rules = rules_by_level(winding, DEFAULT_TOLERANCE)
    distinct = list(dict.fromkeys(rules))
    nodes = tuple(
        NodeRule(
            discrete_gauss(winding.axial_loops, rule.axial_nodes),
            discrete_gauss(winding.radial_loops, rule.radial_nodes),
            rule.steps,
        )
        for rule in distinct
    )
    names = [mover.name for mover in carriers]
    mover = names.index(coil.carried_by) if coil.carried_by is not None else -1
    poses = poses_of(rig, coil, sources, values)
    levels = tuple(distinct.index(rule) for rule in rules)
    leads = coil.leads.pieces if coil.leads is not None else ()
    return PlainCoil(coil.name, winding, mover, *poses, first_level, levels, nodes, leads)


def _flange_from_report(mover: Mover) -> Transform:
    """Turns displacements that are reported in axes of the base into those of the end-effector (`geometry.motion`)."""
    if mover.displacement_frame is not DisplacementFrame.BASE:
        return Transform.identity()
    rotation = rotation_from_vector(torch.tensor(mover.reference_rotation_rad, dtype=torch.float64))
    return Transform(rotation.mT, torch.zeros(3, dtype=torch.float64))


def _alone(pose: Transform) -> Transform:
    """A pose without the axis of poses, of length one."""
    return Transform(pose.rotation.reshape(3, 3), pose.translation_m.reshape(3))
