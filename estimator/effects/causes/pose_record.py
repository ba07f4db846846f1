"""Mistakes in the record of poses: rotations in another convention, lengths in another unit, other axes.

Each is there or not, and makes the readings absurd unless undone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cache
from itertools import permutations, product

from estimator.effects import axis_orders
from estimator.effects.base import POSITIVE, SIGN, Starts, Theta, box, switch, vector, whole
from estimator.effects.circumstances import Circumstances
from estimator.effects.stages import Columns, MotionEffect
from estimator.frames import Transform, rotation_from_vector
from estimator.rig.bodies import MotionKind
from estimator.rig.rig import Rig
from estimator.tensors import torch

# mm under m, m under mm, mm under cm, ..., inch under mm.
LENGTH_FACTORS = (1e3, 1e-3, 10.0, 0.1, 1.0 / 25.4, 25.4)
MRAD = 1e3
ANGLE_FACTORS = {
    180.0 / math.pi: "degrees called radians",
    0.5 / math.pi: "turns called radians",
    MRAD: "mrad called radians",
    math.pi / 180.0: "radians called degrees",
}
# Orders in which turns about fixed axes follow one another, the first one first.
ORDERS = tuple(permutations((0, 1, 2)))
REVERSED = len(ORDERS) + 1
A_CONVENTION = whole(f"must be a whole number from 0 to {REVERSED}", 0.0, REVERSED)
SMALLEST_TURN_RAD = math.radians(15.0)
FACTORS = tuple(f"{axis}_factor" for axis in "xyz")
SIGNS = tuple(f"{axis}_sign" for axis in "xyz")
REVERSALS = (
    (-1.0, 1.0, 1.0),
    (1.0, -1.0, 1.0),
    (1.0, 1.0, -1.0),
    (-1.0, -1.0, -1.0),
)  # of one axis, and of all
TURN = ("rx_rad", "ry_rad", "rz_rad")


def _that_report(*kinds: MotionKind) -> Callable[[Rig], tuple[str, ...]]:
    """Movers that report so."""
    return lambda rig: tuple(mover.name for mover in rig.movers if mover.motion in kinds)


def _with_positions(rig: Rig) -> tuple[str, ...]:
    """Movers whose columns are positions, and no joint angles."""
    return tuple(mover.name for mover in rig.movers if mover.table is None)


def _moved(circumstances: Circumstances, place: str) -> list[str]:
    """Axes along which the mover moved."""
    here_m = circumstances.observations.history.motion[place][:, :3]
    return [axis for i, axis in enumerate("xyz") if bool((here_m[:, i] != here_m[0, i]).any())]


def _usual_slips(circumstances: Circumstances, place: str) -> Starts:
    """The usual slips, on each axis along which the mover went, and on all."""
    moved = _moved(circumstances, place) or ["x", "y", "z"]
    groups = [(axis,) for axis in moved] + ([tuple("xyz")] if len(moved) > 1 else [])
    return tuple(
        {f"{axis}_factor": factor if axis in group else 1.0 for axis in "xyz"}
        for factor in LENGTH_FACTORS
        for group in groups
    )


# Quantities: recorded over true positions.
@MotionEffect.cause(
    quantities=tuple(switch(key, 0.0, 1e9, 1.0, POSITIVE) for key in FACTORS),
    places=_with_positions,
    starts=_usual_slips,
    concerns=lambda circumstances, place: bool(_moved(circumstances, place)),
    is_record_mistake=True,
)
def position_unit(pose: Transform, theta: Theta) -> Transform:
    """Positions are recorded in another unit than stated, along one axis or all.

    One axis of a mover, or all of them, was recorded in another unit than the file says.

    Source: powers of ten between m, cm and mm; inches.
    """
    return Transform(pose.rotation, pose.translation_m / vector(theta, FACTORS))


def _other_conventions(circumstances: Circumstances, place: str) -> Starts:
    """Every convention in every unit, then angles, and rotation vectors with any signs, whose columns are in another order.

    Angles in mrad are thousands: where none is beyond a turn, they would only stand for a sensor that does not turn, as in `field_frame`.
    """
    largest = float(circumstances.observations.history.motion[place][:, 3:].abs().max())
    factors = [factor for factor in ANGLE_FACTORS if factor < MRAD or largest > 2.0 * math.pi]
    right, *others = axis_orders.ORDERS
    each = (
        *product(range(REVERSED + 1), (1.0, *factors), (right,)),
        *product(range(1, REVERSED), (1.0,), (order for order in others if min(order.values()) > 0.0)),
        *product((0,), (1.0,), (order for order in others if order != axis_orders.REVERSED)),
    )
    return tuple({"convention": float(i), "factor": factor, **order} for i, factor, order in each[1:])


def _broken_rule(values: Mapping[str, float]) -> tuple[str, str] | None:
    for key, rule in (("convention", A_CONVENTION), ("factor", POSITIVE)):
        if not rule.holds(values[key]):
            return key, rule.words
    return axis_orders.reads_one_twice(values)


def _meaning(values: Mapping[str, float]) -> str:
    number = round(values["convention"])
    words = ["the inverse rotations"] if number == REVERSED else []
    if 0 < number < REVERSED:
        words.append(f"angles about fixed axes {', then '.join('xyz'[i] for i in ORDERS[number - 1])}")
    words += [unit for factor, unit in ANGLE_FACTORS.items() if math.isclose(factor, values["factor"])]
    is_swapped = any(values[key] != right for key, right in axis_orders.AS_CALLED.items())
    return "; ".join([*words, *([axis_orders.meaning(values)] if is_swapped else [])])


# Quantities: 0: a rotation vector; 1 to 6: angles about fixed axes, in the order xyz, xzy, yxz, yzx, zxy, zyx; 7: the inverse. Recorded
# over true numbers. Which of the three numbers, 1 to 3, each column holds, negative where it is reversed.
@MotionEffect.cause(
    quantities=(
        switch("convention", 0.0, float(REVERSED), 0.0),
        switch("factor", 0.0, 1e9, 1.0),
        *axis_orders.QUANTITIES,
    ),
    places=_that_report(MotionKind.DISPLACEMENT, MotionKind.POSE),
    starts=_other_conventions,
    concerns=lambda circumstances, place: bool(circumstances.observations.history.motion[place][:, 3:].any()),
    columns=lambda circumstances, mover: circumstances.observations.motion[mover][:, 3:],
    broken_rule=_broken_rule,
    meaning=_meaning,
    is_record_mistake=True,
)
def rotation_convention(pose: Transform, columns: Columns, theta: Theta) -> Transform:
    """Rotations are recorded in another convention, unit or order of columns than rotation vectors in radians.

    The three columns of a rotation are no rotation vector in radians: angles about three axes, the inverse rotation, degrees or turns, or
    the columns are in another order.

    Source: angles about the axes in each of 6 orders, the inverse rotation; degrees, turns, mrad, or radians under degrees; 6 orders of
    columns, of a rotation vector with any signs.
    """
    true_from_recorded = axis_orders.recorded_from_true(theta).mT / theta["factor"][..., None, None, None]
    columns = (true_from_recorded @ columns[..., None])[..., 0]
    axes = torch.eye(3).to(columns)
    about = [rotation_from_vector(columns[..., i : i + 1] * axes[i]) for i in range(3)]
    as_angles = [about[third] @ about[second] @ about[first] for first, second, third in ORDERS]
    rotation = rotation_from_vector(columns)
    each = torch.stack((rotation, *as_angles, rotation.mT), dim=-4)
    which = theta["convention"].round().long()[..., None, None, None, None]
    return Transform(torch.take_along_dim(each, which, dim=-4)[..., 0, :, :, :], pose.translation_m)


@MotionEffect.cause(
    quantities=tuple(switch(key, -1.0, 1.0, 1.0, SIGN) for key in SIGNS),
    starts=tuple(dict(zip(SIGNS, signs, strict=True)) for signs in REVERSALS),
    is_record_mistake=True,
)
def left_handed(pose: Transform, theta: Theta) -> Transform:
    """One axis of a mover, or all three, is reversed: its frame is left-handed.

    One recorded axis of a mover, or all three, has the other sign, so that its frame is left-handed.

    Source: 3 axes, and all of them.
    """
    return Transform(pose.rotation, vector(theta, SIGNS) * pose.translation_m)


def _other_orders(circumstances: Circumstances, place: str) -> Starts:
    """Orders and directions that are not those of `left_handed`, nor a rotation where that is a `displacement_frame`."""
    has_frame = circumstances.rig.mover(place).motion is MotionKind.DISPLACEMENT
    return tuple(
        order
        for order in axis_orders.ORDERS[1:]
        if not (axis_orders.is_in_order(order) if axis_orders.is_left_handed(order) else has_frame)
    )


# Quantities: which coordinate, 1 to 3, each column holds, negative where it is reversed.
@MotionEffect.cause(
    quantities=axis_orders.QUANTITIES,
    places=_with_positions,
    starts=_other_orders,
    broken_rule=axis_orders.reads_one_twice,
    meaning=axis_orders.meaning,
    is_record_mistake=True,
)
def positions_swapped(pose: Transform, theta: Theta) -> Transform:
    """The mover's columns x, y and z are in another order or direction.

    The columns of a mover's x, y and z hold each other's numbers, some of them perhaps with the other sign.

    Source: signed permutations; the reversal of one or of all is left_handed.
    """
    true_from_recorded = axis_orders.recorded_from_true(theta).mT
    return Transform(pose.rotation, (true_from_recorded @ pose.translation_m[..., None])[..., 0])


@cache
def _turns() -> tuple[tuple[float, ...], ...]:
    """Rotation vectors of turns in steps of 45 degrees about each axis, no two of them alike, without the identity."""
    steps = list(product(range(0, 360, 45), (-90, -45, 0, 45, 90), range(0, 360, 45)))
    from scipy.spatial.transform import Rotation  # a third of a second, which only rotations as numbers need

    distinct = Rotation.identity(1)
    for turn in Rotation.from_euler("XYZ", steps, degrees=True):
        if (turn.inv() * distinct).magnitude().min() > math.radians(44.0):
            distinct = Rotation.concatenate((distinct, turn))
    return tuple(tuple(vector) for vector in distinct[1:].as_rotvec().tolist())


def _is_large(theta: Theta) -> bool:
    """Whether the turn is large: axes that are turned a little are not mistaken for others."""
    return math.hypot(*(float(turn_rad) for turn_rad in theta.values())) > SMALLEST_TURN_RAD


# Quantities: from the reported to the real axes.
@MotionEffect.cause(
    quantities=box(TURN, "", "rad", 2.0 * math.pi),
    places=_that_report(MotionKind.DISPLACEMENT),
    # The other 23 rotations of a cube, and those half way between about each of its axes.
    starts=lambda: tuple(dict(zip(TURN, turn, strict=True)) for turn in _turns()),
    is_itself=_is_large,
    is_record_mistake=True,
)
def displacement_frame(pose: Transform, theta: Theta) -> Transform:
    """Displacements are reported in other axes than the rig says.

    Displacements are reported in other axes than the rig says, such as those of the robot's base.

    Source: any rotation: a tool may point anywhere.
    """
    turn = rotation_from_vector(vector(theta, TURN)[..., 0, :])
    return Transform(pose.rotation, (turn[..., None, :, :] @ pose.translation_m[..., None])[..., 0])


# Quantities: from the reported to the real axes.
@MotionEffect.cause(
    quantities=box(TURN, "", "rad", 2.0 * math.pi),
    places=_that_report(*(kind for kind in MotionKind if kind is not MotionKind.DISPLACEMENT)),
    starts=lambda: tuple(dict(zip(TURN, turn, strict=True)) for turn in _turns()),
    is_itself=_is_large,
    is_record_mistake=True,
)
def pose_frame(pose: Transform, theta: Theta) -> Transform:
    """The base of a mover is turned against what the rig says, or poses are reported in other axes.

    Positions and rotations are in axes that are turned about the origin of the mover's base: its foot is mounted otherwise, or poses are
    those in another frame.

    Source: any rotation: feature frames and feet of robots may be turned by 45, 90 or 180 degrees.
    """
    turn = rotation_from_vector(vector(theta, TURN)[..., 0, :])
    return Transform(
        turn[..., None, :, :] @ pose.rotation, (turn[..., None, :, :] @ pose.translation_m[..., None])[..., 0]
    )
