"""Windings of a coil that the rig file does not tell of: another one in series, or a part that is wound the other way."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from estimator.effects.base import Quantity, Theta, normal, shape
from estimator.effects.circumstances import Circumstances, Extent
from estimator.effects.stages import AddedLoops
from estimator.field.loop import FEWEST_STEPS
from estimator.field.node_sum import Nodes
from estimator.field.winding import Rule, Winding, loops_of
from estimator.rig.parameters import LogNormal, Normal
from estimator.tensors import torch

HIDDEN_NODES = 6  # loops that stand for a hidden winding
HIDDEN_STEPS = FEWEST_STEPS + 3  # enough wherever it ends up: a millionth of the distance to its other side


class HiddenWinding(AddedLoops):
    """Another winding about the same axis carries the same current, in either sense: a shield, a compensation, a second coil.

    Its numbers count in those of the coil: turns in the coil's turns, lengths in its external radius, heights from its front face.
    """

    name: ClassVar[str] = "hidden_winding"
    words: ClassVar[str] = "another winding about the same axis carries the coil's current"
    source: ClassVar[str] = "wide: shields and compensations have a tenth of the turns and more"
    can_begin: ClassVar[bool] = False
    is_structural: ClassVar[bool] = True

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Share of the coil's turns, negative where wound the other way; radius, middle and length in external radii."""
        return (
            normal("turns", "1", 0.1),
            Quantity("radius", "1", LogNormal(1.0, 0.5), 1.0, is_shape=True),
            Quantity("middle", "1", Normal(-0.5, 1.0), -0.5, is_shape=True),
            Quantity("length", "1", LogNormal(0.5, 1.0), 0.5, is_shape=True),
        )

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Places in the bore, around the winding along all of it and at either end, and behind it."""
        nominal = circumstances.rig.nominal_values()
        radius_m, axial, radial, axial_pitch_m, radial_pitch_m = (
            nominal[f"{place}.{key}"]
            for key in ("radius_m", "axial_loops", "radial_loops", "axial_pitch_m", "radial_pitch_m")
        )
        length, bore = axial * axial_pitch_m / radius_m, 1.0 - radial * radial_pitch_m / radius_m
        places = (
            (0.8 * bore, -0.5 * length, length),
            (1.15, -0.5 * length, length),
            (1.15, -0.1 * length, 0.2 * length),
            (1.15, -0.9 * length, 0.2 * length),
            (1.0, -length - 0.5, 0.2),
        )
        return tuple(dict(zip(("radius", "middle", "length"), values, strict=True)) for values in places)

    def loops(self, winding: Winding, rule: Rule, theta: Theta) -> tuple[Nodes, int]:
        """Gauss nodes along the hidden winding."""
        nodes, weights = (
            torch.from_numpy(v).to(winding.radius_m) for v in np.polynomial.legendre.leggauss(HIDDEN_NODES)
        )
        turns, radius, middle, length = (
            theta[key][..., None] for key in ("turns", "radius", "middle", "length")
        )
        unit_m = winding.radius_m[..., None]
        weight = 0.5 * weights * turns * (winding.axial_loops * winding.radial_loops)[..., None]
        height_m, radius_m, weight = torch.broadcast_tensors(
            unit_m * (middle + 0.5 * length * nodes), unit_m * radius, weight
        )
        loops = Nodes(height_m[..., None], radius_m[..., None], weight[..., None])
        return loops, max(rule.steps, HIDDEN_STEPS)


class ReversedLayer(AddedLoops):
    """A layer of the winding is wound the other way; half as much the other way round is a layer that is missing, or is there twice."""

    name: ClassVar[str] = "reversed_layer"
    words: ClassVar[str] = "a layer is wound the other way"
    source: ClassVar[str] = "up to a whole layer"
    can_begin: ClassVar[bool] = False
    is_structural: ClassVar[bool] = True

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Share of a layer that runs the other way, and where: 0 is the outermost, 1 the innermost."""
        return (normal("share", "1", 0.5), shape("depth", "1", 0.0, 1.0))

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Near the outside, in the middle, near the bore."""
        return tuple({"depth": depth} for depth in (0.05, 0.5, 0.95))

    def loops(self, winding: Winding, rule: Rule, theta: Theta) -> tuple[Nodes, int]:
        """Twice the layer, taken away."""
        in_m = theta["depth"] * winding.radial_pitch_m * (winding.radial_loops - 1.0)
        radius_m, *others = torch.broadcast_tensors(
            winding.radius_m - in_m,
            winding.axial_loops,
            torch.ones_like(in_m),
            winding.axial_pitch_m,
            winding.radial_pitch_m,
        )
        layer = loops_of(Winding(radius_m, *others), Rule(rule.axial_nodes, 1, rule.steps))
        return layer._replace(weight=-2.0 * theta["share"][..., None, None] * layer.weight), rule.steps
