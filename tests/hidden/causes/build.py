"""Flaws of how the source is built: the rig file tells of one winding, wound one way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.hidden.coil import Block, blocks_of, circular_field
from tests.hidden.flaw import Cause, Known, Stage, Truth, sign
from tests.hidden.scene import Scene

LAYER_HEIGHTS = 20


def hidden_winding(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """A layer about the winding, in series with it and told of nowhere: `size` of its turns, in either sense.

    1.03 to 1.5 times as wide, 0.2 to 1 times as long, anywhere along the winding.
    """
    w = scene.winding
    radius_m, length_m = w.radius_m * rng.uniform(1.03, 1.5), w.length_m * rng.uniform(0.2, 1.0)
    front_m = -rng.uniform(0.0, w.length_m - length_m)
    turns = sign(rng) * size * w.axial_loops * w.radial_loops
    heights_m = front_m - length_m * (np.arange(LAYER_HEIGHTS) + 0.5) / LAYER_HEIGHTS
    layer = Block(heights_m, np.full(LAYER_HEIGHTS, 1.0 / LAYER_HEIGHTS), np.array([radius_m]), np.ones(1))
    alone, before = circular_field((layer,)), scene.coil_field
    known = (Known("turns", turns, "1"), Known("radius_m", radius_m, "m"))
    place = (Known("length_m", length_m, "m"), Known("front_m", front_m, "m"))
    made = replace(scene, coil_field=lambda points_m: before(points_m) + turns * alone(points_m))
    return made, Truth("coil1", (*known, *place))


def reversed_layer(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """One layer, the drawn one, is wound the other way; size 1 is all of its turns, and less a share of them, evenly spread."""
    layer = int(rng.integers(scene.winding.radial_loops))
    (whole,) = blocks_of(scene.winding)
    one = circular_field((replace(whole, radii_m=whole.radii_m[layer : layer + 1], layers=np.ones(1)),))
    before = scene.coil_field
    made = replace(scene, coil_field=lambda points_m: before(points_m) - 2.0 * size * one(points_m))
    return made, Truth("coil1", (Known("layer", float(layer), "1"), Known("share", size, "1")))


CAUSES = (
    Cause("hidden_winding", Stage.WINDING, "1", 0.3, hidden_winding, freedom=4),
    Cause("reversed_layer", Stage.WINDING, "1", 1.0, reversed_layer, freedom=2),
)
