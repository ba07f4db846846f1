"""Mistakes in the record of poses: rotations in another convention, lengths in another unit, other axes.

Each is there or not, and makes the readings absurd unless undone.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from itertools import permutations, product

from estimator.effects.base import POSITIVE, SIGN, Starts, Theta, box, switch, vector, whole
from estimator.effects.circumstances import Circumstances
from estimator.effects.stages import Columns, MotionEffect
from estimator.frames import Transform, rotation_from_vector
from estimator.rig.bodies import MotionKind
from estimator.rig.rig import Rig
from estimator.tensors import torch

# mm under m, m under mm, mm under cm, ..., inch under mm.
LENGTH_FACTORS = (1e3, 1e-3, 10.0, 0.1, 1.0 / 25.4, 25.4)
# Orders in which turns about fixed axes follow one another, the first one first.
ORDERS = tuple(permutations((0, 1, 2)))
REVERSED, IN_DEGREES = len(ORDERS) + 1, len(ORDERS) + 2
A_CONVENTION = whole(f"must be a whole number from 0 to {IN_DEGREES}", 0.0, IN_DEGREES)
SMALLEST_TURN_RAD = math.radians(15.0)
FACTORS = tuple(f"{axis}_factor" for axis in "xyz")
SIGNS = tuple(f"{axis}_sign" for axis in "xyz")
TURN = ("rx_rad", "ry_rad", "rz_rad")


def _that_report(*kinds: MotionKind) -> Callable[[Rig], tuple[str, ...]]:
    """Movers that report so."""
    return lambda rig: tuple(mover.name for mover in rig.movers if mover.motion in kinds)


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
    places=lambda rig: tuple(mover.name for mover in rig.movers if mover.table is None),
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


# Quantities: 0: a rotation vector; 1 to 6: angles about fixed axes, in the order xyz, xzy, yxz, yzx, zxy, zyx; 7: the inverse; 8: degrees.
@MotionEffect.cause(
    quantities=(switch("convention", 0.0, float(IN_DEGREES), 0.0, A_CONVENTION),),
    places=_that_report(MotionKind.DISPLACEMENT, MotionKind.POSE),
    starts=tuple({"convention": float(i)} for i in range(1, IN_DEGREES + 1)),
    concerns=lambda circumstances, place: bool(circumstances.observations.history.motion[place][:, 3:].any()),
    columns=lambda circumstances, mover: circumstances.observations.motion[mover][:, 3:],
    is_record_mistake=True,
)
def rotation_convention(pose: Transform, columns: Columns, theta: Theta) -> Transform:
    """Rotations are recorded in another convention than rotation vectors.

    The three columns of a rotation are no rotation vector: angles about three axes, the inverse rotation, or degrees.

    Source: angles about the axes in each of 6 orders, the inverse rotation, degrees.
    """
    axes = torch.eye(3).to(columns)
    about = [rotation_from_vector(columns[:, i : i + 1] * axes[i]) for i in range(3)]
    as_angles = [about[third] @ about[second] @ about[first] for first, second, third in ORDERS]
    rotation = rotation_from_vector(columns)
    each = torch.stack((rotation, *as_angles, rotation.mT, rotation_from_vector(torch.deg2rad(columns))))
    return Transform(each[theta["convention"].round().long()], pose.translation_m)


@MotionEffect.cause(
    quantities=tuple(switch(key, -1.0, 1.0, 1.0, SIGN) for key in SIGNS),
    # Each axis alone, and all.
    starts=(
        *({key: -1.0 if key == reversed_key else 1.0 for key in SIGNS} for reversed_key in SIGNS),
        dict.fromkeys(SIGNS, -1.0),
    ),
    is_record_mistake=True,
)
def left_handed(pose: Transform, theta: Theta) -> Transform:
    """One axis of the displacements is reversed: their frame is left-handed.

    One axis of the recorded displacements is reversed, so that their frame is left-handed.

    Source: 3 axes.
    """
    return Transform(pose.rotation, vector(theta, SIGNS) * pose.translation_m)


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
