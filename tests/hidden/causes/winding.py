"""Flaws of the winding: it is not evenly wound of equal circles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.hidden.coil import (
    MU0,
    CoilField,
    Winding,
    blocks_of,
    circular_field,
    closed_curve_field,
    loop_components,
    polyline_field,
)
from tests.hidden.flaw import Cause, Known, Stage, Truth, sign
from tests.hidden.protocols import Array
from tests.hidden.scene import Scene

# For what an elliptic winding differs from a round one: steps along a loop, and loops per direction.
STEPS = 96
FEW_LOOPS = 6


def axial_pitch(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """Turns stand 2 R_w x factor apart along the axis; layers stay 2 R_w apart."""
    factor = 1.0 + sign(rng) * size
    return _rewound(scene, replace(scene.winding, axial_pitch_factor=factor), factor)


def radial_pitch(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """Layers stand 2 R_w x factor apart; the outermost radius stays where R_c - R_w x factor puts it."""
    factor = 1.0 + sign(rng) * size
    return _rewound(scene, replace(scene.winding, radial_pitch_factor=factor), factor)


def _rewound(scene: Scene, winding: Winding, factor: float) -> tuple[Scene, Truth]:
    truth = Truth("coil1", (Known("factor", factor, "1"),))
    return replace(scene, winding=winding, coil_field=circular_field(blocks_of(winding))), truth


def turns_gradient(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """Turns per length grow linearly towards the front face: density x (1 + gradient u), u = -1 at the back face, +1 at the front."""
    gradient = sign(rng) * size
    (whole,) = blocks_of(scene.winding)
    u = 2.0 * whole.heights_m / scene.winding.length_m + 1.0
    block = replace(whole, turns=whole.turns * (1.0 + gradient * u))
    return replace(scene, coil_field=circular_field((block,))), Truth(
        "coil1", (Known("gradient", gradient, "1"),)
    )


def short_layer(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """The outermost layer lacks a fraction `size` of its turns, at the front or at the back end (drawn); the last one may be a part."""
    is_front = bool(rng.integers(2))
    (whole,) = blocks_of(scene.winding)
    count = scene.winding.axial_loops
    present = np.clip((1.0 - size) * count - np.arange(count), 0.0, 1.0)  # from the end that is complete
    outermost = replace(
        whole,
        turns=whole.turns * (present[::-1] if is_front else present),
        radii_m=whole.radii_m[:1],
        layers=whole.layers[:1],
    )
    others = replace(whole, radii_m=whole.radii_m[1:], layers=whole.layers[1:])
    truth = Truth(
        "coil1", (Known("missing_fraction", size, "1"), Known("missing_at_front", float(is_front), "1"))
    )
    return replace(scene, coil_field=circular_field((others, outermost))), truth


def coil_ovality(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """Ellipses for circles: a loop of radius a has half axes a (1 + size) along `angle_rad` from the coil's x, and a (1 - size) across."""
    angle_rad = rng.uniform(0.0, np.pi)
    truth = Truth("coil1", (Known("ovality", size, "1"), Known("angle_rad", angle_rad, "rad")))
    return replace(scene, coil_field=elliptic_field(scene, size, angle_rad)), truth


def elliptic_field(scene: Scene, ovality: float, angle_rad: float, shear: float = 0.0) -> CoilField:
    """The round winding's field, plus what elliptic loops differ by, summed over a few of them.

    Args:
        scene: Whose coil is bent.
        ovality, angle_rad: As in `coil_ovality`.
        shear: Shift of a loop's centre along the longer axis per height above the winding's middle.
    """
    round_field = scene.coil_field
    if ovality == 0.0 and shear == 0.0:
        return round_field
    (block,) = blocks_of(scene.winding)
    height_m, radius_m, weight = block.reduced(FEW_LOOPS).loops()
    angle = 2.0 * np.pi * np.arange(STEPS) / STEPS
    cos, sin = np.cos(angle), np.sin(angle)
    turn = np.array([[np.cos(angle_rad), -np.sin(angle_rad)], [np.sin(angle_rad), np.cos(angle_rad)]])

    def curves(oval: float, lean: float) -> tuple[Array, Array]:
        a, b = radius_m[:, None] * (1.0 + oval), radius_m[:, None] * (1.0 - oval)
        centre = lean * (height_m + 0.5 * scene.winding.length_m)[:, None]
        flat = np.stack([a * cos + centre, b * sin], axis=2) @ turn.T
        slope = np.stack([-a * sin, b * cos], axis=2) @ turn.T * (2.0 * np.pi / STEPS) * weight[:, None, None]
        level = np.broadcast_to(height_m[:, None, None], (len(height_m), STEPS, 1))
        return np.concatenate([flat, level], axis=2), np.concatenate([slope, np.zeros_like(level)], axis=2)

    def field(points_m: Array) -> Array:
        places, place = np.unique(points_m, axis=0, return_inverse=True)
        change = closed_curve_field(places, *curves(ovality, shear)) - closed_curve_field(
            places, *curves(0.0, 0.0)
        )
        return np.asarray(round_field(points_m) + change[place.ravel()])

    return field


def lead_wire(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """The two leads run straight out from the winding, apart instead of twisted.

    A rectangle in a plane through the axis at `angle_rad` from the coil's x: from the outer radius outwards over `length_m`, `size` wide
    along the axis, about the middle height. The current runs outwards on the side of the front face and returns on the other.
    """
    angle_rad, length_m = rng.uniform(-np.pi, np.pi), rng.uniform(0.1, 0.3)
    outward = np.array([np.cos(angle_rad), np.sin(angle_rad), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    near, far = scene.winding.radius_m * outward, (scene.winding.radius_m + length_m) * outward
    middle = -0.5 * scene.winding.length_m
    front, back = (middle + 0.5 * size) * up, (middle - 0.5 * size) * up
    corners_m = np.array([near + front, far + front, far + back, near + back, near + front])
    before = scene.coil_field

    def field(points_m: Array) -> Array:
        return before(points_m) + (polyline_field(points_m, corners_m) if size > 0.0 else 0.0)

    known = (
        Known("gap_m", size, "m"),
        Known("length_m", length_m, "m"),
        Known("angle_rad", angle_rad, "rad"),
    )
    return replace(scene, coil_field=field), Truth("coil1", known)


def spherical_sum(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """A share `size` of the field is the paper's literal sum: spherical components of loops with different centres are added.

    Each loop's B_r and B_theta about its own centre are summed as if they shared the axes that belong to the front face's centre.

    References: Osinde et al., eq 13.
    """
    del rng
    height_m, radius_m, weight = blocks_of(scene.winding)[0].loops()
    right = scene.coil_field

    def field(points_m: Array) -> Array:
        rho_m, h_rho, h_z = loop_components(points_m, height_m, radius_m)
        above_m = points_m[:, 2:3] - height_m
        distance_m = np.hypot(rho_m[:, None], above_m)
        sine, cosine = rho_m[:, None] / distance_m, above_m / distance_m
        b_r, b_theta = ((h_rho * sine + h_z * cosine) @ weight, (h_rho * cosine - h_z * sine) @ weight)
        r_m = np.hypot(rho_m, points_m[:, 2])
        sin, cos = rho_m / r_m, points_m[:, 2] / r_m
        b_rho, b_z = MU0 * (b_r * sin + b_theta * cos), MU0 * (b_r * cos - b_theta * sin)
        unit = points_m[:, :2] / np.where(rho_m > 0.0, rho_m, 1.0)[:, None]
        literal = np.column_stack([unit * b_rho[:, None], b_z])
        return np.asarray((1.0 - size) * right(points_m) + size * literal)

    return replace(scene, coil_field=field), Truth("coil1", (Known("share", size, "1"),))


CAUSES = (
    Cause("axial_pitch", Stage.WINDING, "1", 0.1, axial_pitch),
    Cause("radial_pitch", Stage.WINDING, "1", 0.1, radial_pitch),
    Cause("turns_gradient", Stage.WINDING, "1", 0.3, turns_gradient),
    Cause("short_layer", Stage.WINDING, "1", 0.9, short_layer),
    Cause("coil_ovality", Stage.WINDING, "1", 0.03, coil_ovality, freedom=2),
    Cause("lead_wire", Stage.WINDING, "m", 0.04, lead_wire, freedom=3),
    Cause("spherical_sum", Stage.WINDING, "1", 1.0, spherical_sum),
)
