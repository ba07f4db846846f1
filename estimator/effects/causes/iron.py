"""Iron in the room that the coils magnetise: a plate, a plate with an opening, a small piece."""

from __future__ import annotations

import math
from itertools import product

from jaxtyping import Float

from estimator.effects.base import (
    Quantities,
    Quantity,
    Starts,
    Theta,
    at_least_zero,
    box,
    fixed,
    normal,
    shape,
    vector,
)
from estimator.effects.circumstances import Circumstances, Extent
from estimator.effects.stages import Field, PerAmpere, Points, RoomEffect
from estimator.field.dipole import dipole_field
from estimator.field.opening import RING, through_opening
from estimator.rig.parameters import Normal
from estimator.tensors import Tensor, torch

GAPS = (0.3, 1.0)  # of the reach, between the positions and a plane behind them
LEAST_BETWEEN = 0.5  # of the reach: how far sensors must lie apart for a plate to stand between them
BETWEEN = (0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875)
WIDER = 1.3  # than the positions beside the axis: an opening to start from
LEAST_OPENING = 1e-3  # of the reach
NEAR = 4.0  # of the reach: from farther off, a piece of iron shows only where it is as large as a rack
LIKELY_RADIUS_M, LIKELY_RADIUS = 0.05, 0.3  # of an equivalent ball of iron; the second of the reach
MOST_STRENGTH = 1.1  # of a perfect sheet's: room for what a sheet without thickness leaves out
# The world's axis nearest to a normal (0 x, 1 y, 2 z), and tilts of the normal towards the next two (x, y, z, x, y).
DIRECTION = (fixed("axis", "1", 0.0, 2.0), *box(("tilt_1", "tilt_2"), "_rad", "rad", 0.5 * math.pi))


def _in_axis(axis: int, **numbers: float) -> dict[str, float]:
    """Shapes of a plane across an axis of the world."""
    return {"axis": float(axis), "tilt_1_rad": 0.0, "tilt_2_rad": 0.0, **numbers}


def _planes_about(circumstances: Circumstances) -> Starts:
    """Planes across the world's axes, before and behind all windings and sensors."""
    positions_m = circumstances.positions_m
    starts = []
    for axis, across in enumerate(torch.eye(3, dtype=positions_m.dtype, device=positions_m.device)):
        ends_m = torch.cat((positions_m[:, axis], *_windings_along_m(circumstances, across)))
        for end_m, side in ((ends_m.max(), 1.0), (ends_m.min(), -1.0)):
            gaps_m = (gap * circumstances.reach_m for gap in GAPS)
            starts += [_in_axis(axis, distance_m=float(end_m) + side * gap_m) for gap_m in gaps_m]
    return tuple(starts)


def _windings_along_m(
    circumstances: Circumstances, across: Float[Tensor, "3"]
) -> list[Float[Tensor, " end"]]:
    """How far along a direction each round winding begins and ends, at all poses."""
    result = []
    for coil in circumstances.rig.round:
        radius_m, _, length_m = circumstances.winding_m(coil.name)
        pose = circumstances.world_from(coil)
        lean, front_m = pose.rotation[..., 2] @ across, pose.translation_m @ across
        beside_m = radius_m * (1.0 - lean.square()).clamp(min=0.0).sqrt()
        middles_m = torch.stack((front_m, front_m - length_m * lean))
        result.append(torch.stack((middles_m - beside_m, middles_m + beside_m)).flatten())
    return result


def _has_all_on_one_side(theta: Theta, circumstances: Circumstances) -> bool:
    """Whether neither a sensor nor a winding went through the plane: each was on one of its sides."""
    across = _across(theta)[..., 0, :]
    sensors_m = (circumstances.sensor_positions_m * across).sum(-1)
    bodies_m = (sensors_m, *_windings_along_m(circumstances, across))
    return not any(bool(along_m.min() < theta["distance_m"] < along_m.max()) for along_m in bodies_m)


# Quantities: strength of the image, direction across the plane, and how far along it the plane lies from the world's origin.
@RoomEffect.cause(
    "response",
    quantities=lambda extent: (
        Quantity("strength", "1", Normal(0.0, 0.5, lower=0.0, upper=MOST_STRENGTH)),
        *DIRECTION,
        shape("distance_m", "m", -8.0 * extent.reach_m, 8.0 * extent.reach_m),
    ),
    starts=_planes_about,
    is_itself=_has_all_on_one_side,
)
def iron_plate(per_ampere: PerAmpere, points_m: Points, theta: Theta) -> Field:
    """A plate of iron is magnetised by the coils.

    A large plate of iron adds the field of the coils' images and shields what is behind it.

    Source: strength (mu - 1) / (mu + 1) is below 1; a thin or far plate gives less.
    """
    across = _across(theta)
    depth_m = (points_m * across).sum(-1) - theta["distance_m"][..., None]
    coil_m = (per_ampere.position_m * across).sum(-1) - theta["distance_m"][..., None]
    return theta["strength"][..., None, None] * _sheet(per_ampere, points_m, across, depth_m, coil_m)


def _planes_between(circumstances: Circumstances) -> Starts:
    """Planes across the world's axes along which the sensors lie apart, and the widest, open as wide as these lie about their middle."""
    low_m, high_m = _ends_m(circumstances)
    spread_m, starts = high_m - low_m, []
    least_m = min(float(spread_m.max()), LEAST_BETWEEN * circumstances.reach_m)
    for axis, share in product((spread_m >= least_m).nonzero().flatten().tolist(), BETWEEN):
        middle_m = 0.5 * (low_m + high_m)
        beside_m = circumstances.sensor_positions_m - middle_m
        middle_m[axis], beside_m[:, axis] = float(low_m[axis]) + share * float(spread_m[axis]), 0.0
        wide_m = float(beside_m.norm(dim=-1).max())
        middle = {f"{name}_m": at_m for name, at_m in zip("xyz", middle_m.tolist(), strict=True)}
        radius_m = max(WIDER * wide_m, 2.0 * LEAST_OPENING * circumstances.reach_m)
        starts.append(_in_axis(axis, **middle, radius_m=radius_m))
    return tuple(starts)


def _is_between_sensors(theta: Theta, circumstances: Circumstances) -> bool:
    """Whether sensors are on both of its sides, and came there through the opening: from far away its step is a field of the room."""
    from_middle_m, across = circumstances.sensor_positions_m - vector(theta, "xyz", "_m"), _across(theta)
    depth_m = (from_middle_m * across).sum(-1)
    if not bool(depth_m.min() < 0.0 < depth_m.max()):
        return False
    beside_m = from_middle_m - depth_m[:, None] * across
    return bool(beside_m.mean(0).norm() < theta["radius_m"])


def _step_T(points_m: Points, theta: Theta) -> Field:
    """Field in the world frame, in T: half of the step on each side, and what the opening lets through of it."""
    across, half_T = _across(theta), 0.5 * theta["step_T"][..., None]
    from_middle_m = points_m - vector(theta, "xyz", "_m")
    side = torch.where((from_middle_m * across).sum(-1) < 0.0, -1.0, 1.0)
    leak = through_opening(from_middle_m, across, theta["radius_m"], half_T, half_T)
    return (side * half_T)[..., None] * across + leak


def _lie_apart(circumstances: Circumstances) -> bool:
    """Whether the sensors' positions spread far enough for a plate between them."""
    low_m, high_m = _ends_m(circumstances)
    return float((high_m - low_m).max()) > LEAST_BETWEEN * circumstances.reach_m


# Quantities: share of a perfect plate, step of the room's field along its normal, the normal, and middle and radius of the opening.
@RoomEffect.cause(
    "response",
    quantities=lambda extent: (
        Quantity("strength", "1", Normal(0.0, 1.0, lower=0.0, upper=MOST_STRENGTH)),
        normal("step_T", "T", 3e-4),
        *DIRECTION,
        *box("xyz", "_m", "m", 8.0 * extent.reach_m),
        shape("radius_m", "m", LEAST_OPENING * extent.reach_m, 8.0 * extent.reach_m),
    ),
    concerns=_lie_apart,
    starts=_planes_between,
    is_itself=_is_between_sensors,
    steady_T=_step_T,
)
def pierced_plate(per_ampere: PerAmpere, points_m: Points, theta: Theta) -> Field:
    """A plate of iron with a round opening stands between the readings.

    A large plate of iron with a round opening, through which sensors reached both of its sides.

    The coils magnetise it, and the room's own field across it may differ from one side to the other.

    Source: 1 is a perfect sheet; the end plate of a measured solenoid has 1.05, and steps of 0.3 to 0.4 mT.
    """
    # A plate without opening, and what the opening lets through (see `through_opening`).
    across = _across(theta)
    middle_m = vector(theta, "xyz", "_m")
    depth_m = ((points_m - middle_m) * across).sum(-1)
    coil_m = ((per_ampere.position_m - middle_m) * across).sum(-1)
    towards_coil = torch.where(coil_m < 0.0, -1.0, 1.0)[..., None] * across
    at_m = torch.cat((middle_m, _ring_m(middle_m, across, theta["radius_m"])), dim=-2)
    there_T = (per_ampere.at_each(at_m) * towards_coil[..., None, :]).sum(-1)
    leak = through_opening(
        points_m - middle_m, towards_coil, theta["radius_m"], there_T[..., 1:].mean(-1), there_T[..., 0]
    )
    return theta["strength"][..., None, None] * (_sheet(per_ampere, points_m, across, depth_m, coil_m) + leak)


def _ends_m(circumstances: Circumstances) -> tuple[Float[Tensor, "3"], Float[Tensor, "3"]]:
    """Lowest and highest position of the sensors along each axis of the world."""
    positions_m = circumstances.sensor_positions_m
    return positions_m.min(0).values, positions_m.max(0).values


def _ring_m(
    middle_m: Float[Tensor, "*#batch 1 3"],
    across: Float[Tensor, "*#batch 1 3"],
    radius_m: Float[Tensor, "*#batch"],
) -> Float[Tensor, "*batch 3 3"]:
    """Points over which the field in the opening is averaged: a third of a turn apart, so that slopes and saddles cancel."""
    axes = torch.eye(3, dtype=across.dtype, device=across.device)
    along = torch.nn.functional.normalize(torch.linalg.cross(across, axes[across.abs().argmin(-1)]), dim=-1)
    beside = torch.linalg.cross(across, along)
    turn = across.new_tensor([0.0, 1.0, 2.0])[:, None] * 2.0 * math.pi / 3.0
    ring = torch.cos(turn) * along + torch.sin(turn) * beside
    return middle_m + RING * radius_m[..., None, None] * ring


def _across(theta: Theta) -> Float[Tensor, "*batch 1 3"]:
    """Unit vector across the plane."""
    first, second = theta["tilt_1_rad"], theta["tilt_2_rad"]
    from_axis = torch.stack(
        (torch.cos(first) * torch.cos(second), torch.sin(first), torch.cos(first) * torch.sin(second)), dim=-1
    )
    order = (torch.arange(3, device=first.device) - theta["axis"].long()[..., None]) % 3
    return torch.gather(from_axis, -1, order)[..., None, :]


def _sheet(
    per_ampere: PerAmpere,
    points_m: Points,
    across: Float[Tensor, "*#batch 1 3"],
    depth_m: Float[Tensor, "*#batch pose"],
    coil_m: Float[Tensor, "*#batch #pose"],
) -> Float[Tensor, "*batch pose 3"]:
    """What a perfect sheet adds: before it the field of the coil's image, behind it the coil's field with the opposite sign.

    A thin sheet that reflects the share r lets 1 - r pass: then the field along the sheet is the same on both sides.
    References: Jackson, Classical Electrodynamics, 3rd ed., section 5.17 (image), 5.8 (continuity).
    """
    is_behind = (depth_m * coil_m < 0.0)[..., None]
    field = per_ampere.at(torch.where(is_behind, points_m, points_m - 2.0 * depth_m[..., None] * across))
    turned = field - 2.0 * (field * across).sum(-1, keepdim=True) * across
    return -torch.where(is_behind, field, turned)


def _somewhere_near(extent: Extent) -> Quantities:
    """Radius cubed of an equivalent ball of iron, and where it lies in the world."""
    near_m = NEAR * extent.reach_m
    return (
        at_least_zero("volume_m3", "m3", max(LIKELY_RADIUS_M, LIKELY_RADIUS * extent.reach_m) ** 3),
        *(
            shape(f"{axis}_m", "m", middle_m - near_m, middle_m + near_m)
            for axis, middle_m in zip("xyz", extent.middle_m, strict=True)
        ),
    )


def _around(circumstances: Circumstances) -> Starts:
    """Around the middle of coils and sensors, at two distances."""
    middle = circumstances.positions_m.mean(0)
    starts = []
    for direction in (each for each in product((-1, 0, 1), repeat=3) if any(each)):
        along = torch.nn.functional.normalize(middle.new_tensor(direction), dim=0)
        farthest_m = float(((circumstances.positions_m - middle) @ along).max())
        for gap in (0.4, 1.2):
            point = middle + along * (farthest_m + gap * circumstances.reach_m)
            starts.append(dict(zip(("x_m", "y_m", "z_m"), point.tolist(), strict=True)))
    return tuple(starts)


IRON = (
    "a ball of iron of radius a has 4 pi a^3 / mu0: tools and fittings have 1 to 5 cm, tables and racks more"
)


@RoomEffect.cause("response", source=IRON, quantities=_somewhere_near, starts=_around)
def iron_body(per_ampere: PerAmpere, points_m: Points, theta: Theta) -> Field:
    """A piece of iron in the room is magnetised by the coils.

    One small piece of iron in the room. Its `volume_m3` is the cubed radius of a ball of iron with the same moment, whose own
    volume is 4 pi / 3 times that.
    """
    return _dipole_of_body(per_ampere, points_m, theta)


def _dipole_of_body(per_ampere: PerAmpere, points_m: Points, theta: Theta) -> Field:
    """Dipole 4 pi a^3 / mu0 times the coil's field at the body (Jackson, section 5.11)."""
    body_m = vector(theta, "xyz", "_m")
    at_body = per_ampere.at_each(body_m)[..., 0, :]
    return theta["volume_m3"][..., None, None] * dipole_field(points_m - body_m, at_body)


@RoomEffect.cause(
    "response",
    source=IRON,
    quantities=_somewhere_near,
    starts=_around,
    repeats=iron_body,
)
def second_iron_body(per_ampere: PerAmpere, points_m: Points, theta: Theta) -> Field:
    """A second piece of iron in the room is magnetised by the coils.

    Another piece beside the one that the rig has; they do not magnetise each other.

    It is asked once a first piece is there, for before that both would be the same cause twice. It is no second picture of the first, as a
    plate would be.
    """
    return _dipole_of_body(per_ampere, points_m, theta)
