"""How the loops of a real coil stand, its leads, and iron in its bore."""

from __future__ import annotations

import math

import numpy as np

from estimator.effects.base import Quantity, Theta, normal, pure, shape
from estimator.effects.circumstances import Circumstances
from estimator.effects.stages import Current, Field, Points, SourceEffect
from estimator.field.node_sum import Nodes
from estimator.field.straight import MU0_OVER_4PI, segment_field
from estimator.field.winding import Winding, field_of_loops, loops_of
from estimator.field.winding_shape import Rule
from estimator.rig.parameters import LogNormal
from estimator.tensors import torch

POINTS_AT_ONCE = 1000  # in all of a batch: more would push the dozen arrays of an oval coil out of the cache
OVAL_NODES = 32  # along a loop; the trapezoidal rule converges geometrically on a closed smooth curve


# Quantities: cosine and sine part of the relative change of radius.
@SourceEffect.cause(quantities=pure(cos2=0.01, sin2=0.01), is_structural=True)
def coil_ovality(points_coil_m: Points, winding: Winding, rule: Rule, theta: Theta) -> Field:
    """The loops are oval.

    Loops are ellipses: r = a (1 + e cos 2(phi - phi0)).

    Source: a coil pressed in a vice or wound on a printed former, 0 to 2 %.
    """
    batch = np.broadcast_shapes(points_coil_m.shape[:-2], winding.radius_m.shape)
    n_points = max(1, POINTS_AT_ONCE // math.prod(batch))
    parts = [
        _oval_less_round(some_m, winding, rule, theta) for some_m in points_coil_m.split(n_points, dim=-2)
    ]
    return parts[0] if len(parts) == 1 else torch.cat(parts, dim=-2)


def _oval_less_round(points_coil_m: Points, winding: Winding, rule: Rule, theta: Theta) -> Field:
    """Field of oval minus round loops per ampere, to first order in the ovality, by Biot and Savart on few loops."""
    few = Rule(min(rule.axial_nodes, 4), min(rule.radial_nodes, 2), rule.steps)
    loops = torch.broadcast_tensors(*loops_of(winding, few))
    height, radius, weight = (value.flatten(-2) for value in loops)
    phi = 2.0 * math.pi / OVAL_NODES * torch.arange(OVAL_NODES).to(points_coil_m)
    cos, sin, cos_twice, sin_twice = phi.cos(), phi.sin(), (2.0 * phi).cos(), (2.0 * phi).sin()
    cos2, sin2 = (theta[key][..., None] for key in ("cos2", "sin2"))
    swell, turn = cos2 * cos_twice + sin2 * sin_twice, 2.0 * (sin2 * cos_twice - cos2 * sin_twice)
    # axes: batch, place, loop, phi
    a = radius[..., None, :, None]
    x, y, z = (points_coil_m[..., i, None, None] for i in range(3))
    dx, dy, dz = x - a * cos, y - a * sin, z - height[..., None, :, None]
    e, t = swell[..., None, None, :], turn[..., None, None, :]
    lx, ly = -a * sin, a * cos
    ex, ey = a * (t * cos - e * sin), a * (t * sin + e * cos)  # change of dl
    px, py = -a * e * cos, -a * e * sin  # change of the vector to the point
    r2 = dx**2 + dy**2 + dz**2
    inverse = r2**-1.5
    shrink = -3.0 * (dx * px + dy * py) / r2
    cross = (ly * dz, -lx * dz, lx * dy - ly * dx)
    change = (ey * dz, -ex * dz, ex * dy + lx * py - ey * dx - ly * px)
    parts = [((d + shrink * c) * inverse).mean(-1) for c, d in zip(cross, change, strict=True)]
    scale = MU0_OVER_4PI * 2.0 * math.pi
    return scale * torch.stack([(weight[..., None, :] * part).sum(-1) for part in parts], dim=-1)


# Quantities: shift along x and y per height above the middle of the winding.
@SourceEffect.cause(quantities=pure(shear_x=0.02, shear_y=0.02), is_structural=True)
def winding_sheared(points_coil_m: Points, winding: Winding, rule: Rule, theta: Theta) -> Field:
    """The winding leans: its loops' centres shift with the height.

    Loops lean: each stands across the axis, but their centres run away from it with the height.

    Source: turns that slipped on a former, or a former printed askew: 0.2 to 1 mm over 50 mm.
    """
    loops = loops_of(winding, rule)
    above_m = loops.height_m[..., 0] + 0.5 * winding.length_m[..., None]
    x_m, y_m = (theta[f"shear_{axis}"][..., None] * above_m for axis in "xy")
    shift_m = torch.stack(torch.broadcast_tensors(x_m, y_m, torch.zeros_like(above_m)), dim=-1)
    at_height = Nodes(loops.height_m[..., None], loops.radius_m[..., None, :, :], loops.weight[..., None, :])
    of_heights = field_of_loops(points_coil_m[..., None, :, :] - shift_m[..., None, :], at_height, rule.steps)
    return of_heights.sum(-3) - field_of_loops(points_coil_m, loops, rule.steps)


# Quantities: distance of the leads (positive: the current runs out on the side of the front face), azimuth and length.
@SourceEffect.cause(
    quantities=(
        normal("gap_m", "m", 0.01),
        shape("azimuth_rad", "rad", -2.0 * math.pi, 2.0 * math.pi),
        Quantity("length_m", "m", LogNormal(0.2, 0.7), 0.2, is_shape=True),
    ),
    starts=tuple({"azimuth_rad": math.pi * i / 4.0, "length_m": 0.2} for i in range(-3, 5)),
)
def lead_wire(points_coil_m: Points, winding: Winding, theta: Theta) -> Field:
    """The leads run out of the winding apart instead of twisted.

    The two leads run straight out from the middle of the winding, apart along the axis instead of twisted.

    Source: leads lie some millimetres to centimetres apart over 0.1 to 0.5 m.
    """
    azimuth, zero = theta["azimuth_rad"], torch.zeros_like(theta["gap_m"])
    outward = torch.stack((torch.cos(azimuth), torch.sin(azimuth), zero), dim=-1)
    up = points_coil_m.new_tensor([0.0, 0.0, 1.0])
    near, far = (r[..., None] * outward for r in (winding.radius_m, winding.radius_m + theta["length_m"]))
    middle_m, half_m = -0.5 * winding.length_m, 0.5 * theta["gap_m"]
    front, back = ((middle_m + side * half_m)[..., None] * up for side in (1.0, -1.0))
    corners = (near + front, far + front, far + back, near + back)
    total = torch.zeros_like(points_coil_m)
    for start, end in zip(corners, (*corners[1:], corners[0]), strict=True):
        total = total + segment_field(points_coil_m, start, end)
    return total


def _rod_per_moment(points_coil_m: Points, winding: Winding) -> Field:
    """Field of a rod in the bore, as long as the winding and magnetised along the axis, in units of the winding's own moment."""
    pole = (MU0_OVER_4PI * winding.moment_m2 / winding.length_m)[..., None, None]
    up = points_coil_m.new_tensor([0.0, 0.0, 1.0])
    front_m, back_m = points_coil_m, points_coil_m + winding.length_m[..., None, None] * up
    from_front, from_back = (r / r.norm(dim=-1, keepdim=True) ** 3 for r in (front_m, back_m))
    return pole * (from_front - from_back)


def _has_room_in_bore(circumstances: Circumstances, place: str) -> bool:
    """Whether iron could be in the bore: no sensor went through it."""
    return not circumstances.has_sensor_in_bore(place)


# Quantities: moment of the rod in units of the winding's.
@SourceEffect.cause(quantities=pure(share=0.1), concerns=_has_room_in_bore, is_structural=True)
def iron_core(points_coil_m: Points, winding: Winding, theta: Theta) -> Field:
    """Iron in the bore adds to the coil's moment.

    Iron in the bore adds a moment along the axis, proportional to the current.

    Source: wide: a screw adds per mille, a core multiplies.
    """
    return theta["share"][..., None, None] * _rod_per_moment(points_coil_m, winding)


def _saturating(current_A: Current, theta: Theta) -> Current:
    """Moment of the rod over that of the winding at one ampere."""
    share, loss = theta["share"][..., None], theta["loss_per_A2"][..., None]
    return (share - loss * current_A**2) * current_A


# Quantities: moment at small current in units of the winding's, and its loss per square ampere.
@SourceEffect.cause(
    quantities=lambda extent: (
        normal("share", "1", 0.1),
        normal("loss_per_A2", "1/A2", 0.05 / extent.largest_current_A**2),
    ),
    concerns=_has_room_in_bore,
    drive=_saturating,
    is_structural=True,
    is_linear=False,
)
def core_saturation(points_coil_m: Points, winding: Winding) -> Field:
    """Iron in the bore saturates.

    Iron in the bore that gives less the more current flows.

    Source: wide: a core in a coil of some amperes may lose any part of its moment.
    """
    return _rod_per_moment(points_coil_m, winding)
