"""How a real winding differs from the N_a x N_r equal circular loops, or straight sides, that the rig file states."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from estimator.effects.base import Quantity, Starts, Theta, fixed, normal, pure, shape, share
from estimator.effects.circumstances import Circumstances
from estimator.effects.stages import AddedLoops, SidesEffect, WindingEffect
from estimator.field.loop import FEWEST_STEPS
from estimator.field.node_sum import Nodes
from estimator.field.sided import SidedWinding
from estimator.field.winding import Winding, loops_of
from estimator.field.winding_shape import Rule
from estimator.rig.parameters import LogNormal, Normal
from estimator.tensors import Tensor, torch

LAYER_NODES = 8  # along the missing part of a layer
HIDDEN_NODES = 6  # loops that stand for a hidden winding
HIDDEN_STEPS = FEWEST_STEPS + 3  # enough wherever it ends up: a millionth of the distance to its other side


def _wire_of_an_open_pitch(circumstances: Circumstances, place: str) -> frozenset[str]:
    """The wire where the rig file leaves a pitch open: its own prior bounds what can be built, as for `axial_pitch`."""
    pitches = (circumstances.rig.parameters[f"{place}.{key}_pitch_m"] for key in ("axial", "radial"))
    return frozenset(("wire",)) if any(pitch.is_free for pitch in pitches) else frozenset()


# Quantities: of the external radius, of the wire's thickness and of both numbers of loops.
@WindingEffect.cause(
    quantities=share(radius=0.02, wire=0.02, axial_loops=0.03, radial_loops=0.03),
    unseen=_wire_of_an_open_pitch,
    can_begin=False,
    is_structural=True,
)
def winding_misstated(winding: Winding, theta: Theta) -> Winding:
    """The winding has another radius, wire or number of loops than stated.

    The winding has another radius, wire or number of loops than the rig file says.

    Source: radii by calliper over the insulation, 2 %; enamelled wire, 2 %; loops counted from outside, 3 %.
    """
    keys = {"radius_m": "radius", "axial_pitch_m": "wire", "radial_pitch_m": "wire"}
    numbers = ("radius_m", "axial_loops", "radial_loops", "axial_pitch_m", "radial_pitch_m")
    return winding.scaled(**{number: 1.0 + theta[keys.get(number, number)] for number in numbers})


def _corner_and_wire(circumstances: Circumstances, place: str) -> frozenset[str]:
    """The corner of a winding with sharp ones, and the wire of one with an open pitch."""
    has_corner = f"{place}.inner_corner_radius_m" in circumstances.rig.parameters
    return _wire_of_an_open_pitch(circumstances, place) | frozenset(() if has_corner else ("corner",))


# Quantities: of both sides of the bore, of its corner radius, of the wire's thickness and of both numbers of loops.
@SidesEffect.cause(
    quantities=share(side_x=0.02, side_y=0.02, corner=0.1, wire=0.02, axial_loops=0.03, radial_loops=0.03),
    unseen=_corner_and_wire,
    is_structural=True,
)
def sides_misstated(winding: SidedWinding, theta: Theta) -> SidedWinding:
    """The winding has other sides, corners, wire or number of loops than stated.

    The winding with straight sides has other sides, corners, wire or number of loops than the rig file says.

    Source: formers by calliper under a wire that bulges, 2 %; corners by radius gauge, 10 %; enamelled wire, 2 %; loops from outside, 3 %.
    """
    keys = ("side_x", "side_y", "corner", "axial_loops", "radial_loops", "wire", "wire")
    numbers = (number * (1.0 + theta[key]) for number, key in zip(winding.numbers, keys, strict=True))
    return SidedWinding(winding.is_rounded, *torch.broadcast_tensors(*numbers))


def _is_pitch_fixed(key: str) -> Callable[[Circumstances, str], bool]:
    """Whether the rig file fixes the pitch; a free one's own prior bounds what can be built."""
    return lambda circumstances, place: not circumstances.rig.parameters[f"{place}.{key}"].is_free


@WindingEffect.cause(
    quantities=share(excess=0.02), concerns=_is_pitch_fixed("axial_pitch_m"), can_begin=False
)
def axial_pitch(winding: Winding, theta: Theta) -> Winding:
    """Turns lie wider along the axis than the wire is thick.

    The wire lies wider (or closer) along the axis than its diameter.

    Source: play between turns of orthocyclic windings, 0 to 2 %.
    """
    return winding.scaled(axial_pitch_m=1.0 + theta["excess"])


@WindingEffect.cause(
    quantities=share(excess=0.05), concerns=_is_pitch_fixed("radial_pitch_m"), can_begin=False
)
def radial_pitch(winding: Winding, theta: Theta) -> Winding:
    """Layers lie closer than the wire is thick.

    Layers lie closer (or wider) than the wire is thick.

    Source: layers in each other's grooves: up to 13 % closer; the MICE coils 39 %.
    """
    return winding.scaled(radial_pitch_m=1.0 + theta["excess"])


# Quantities: relative excess of turns per length at the front face.
@AddedLoops.cause(quantities=pure(slope=0.05), can_begin=False)
def turns_gradient(winding: Winding, rule: Rule, theta: Theta) -> tuple[Nodes, int]:
    """Turns lie denser towards one end.

    Turns lie denser towards one end of the winding.

    Source: wide: hand-wound coils.
    """
    loops = loops_of(winding, rule)
    half_m = 0.5 * winding.length_m[..., None, None]
    excess = theta["slope"][..., None, None] * (loops.height_m + half_m) / half_m
    return loops._replace(weight=loops.weight * excess), rule.steps


# Quantities: share of the layer that is missing, and at which end.
@AddedLoops.cause(
    quantities=(normal("missing", "1", 0.5), fixed("at_front", "1", 0.0, 1.0)),
    starts=({"at_front": 1.0}, {"at_front": 0.0}),
    can_begin=False,
    is_structural=True,
)
def short_layer(winding: Winding, rule: Rule, theta: Theta) -> tuple[Nodes, int]:
    """The outermost layer is not wound to its end.

    The outermost layer ends before the face of the winding.

    Source: up to a whole layer may be missing.
    """
    nodes, weights = _gauss(LAYER_NODES, winding)
    share, at_front = theta["missing"][..., None], theta["at_front"][..., None]
    depth = 0.5 * (nodes + 1.0) * share  # from the end, in units of the length
    height_m = -winding.length_m[..., None] * torch.where(at_front > 0.5, depth, 1.0 - depth)
    radius_m = (winding.radius_m - 0.5 * winding.radial_pitch_m)[..., None]
    weight = -0.5 * weights * share * winding.axial_loops[..., None]
    return _single_file(height_m, radius_m, weight), rule.steps


# Quantities: share of a layer that runs the other way, and where: 0 is the outermost, 1 the innermost.
@AddedLoops.cause(
    quantities=(*pure(share=0.5), shape("depth", "1", 0.0, 1.0)),
    starts=({"depth": 0.05}, {"depth": 0.5}, {"depth": 0.95}),
    can_begin=False,
    is_structural=True,
)
def reversed_layer(winding: Winding, rule: Rule, theta: Theta) -> tuple[Nodes, int]:
    """A layer is wound the other way.

    A layer of the winding is wound the other way; half as much the other way round is a layer that is missing, or is there twice.

    Source: up to a whole layer.
    """
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


def _hidden_places(circumstances: Circumstances, place: str) -> Starts:
    """Places in the bore, around the winding along all of it and at either end, and behind it."""
    radius_m, bore_m, length_m = circumstances.winding_m(place)
    bore, length = bore_m / radius_m, length_m / radius_m
    places = (
        (0.8 * bore, -0.5 * length, length),
        (1.15, -0.5 * length, length),
        (1.15, -0.1 * length, 0.2 * length),
        (1.15, -0.9 * length, 0.2 * length),
        (1.0, -length - 0.5, 0.2),
    )
    return tuple(dict(zip(("radius", "middle", "length"), values, strict=True)) for values in places)


# Quantities: share of the coil's turns, negative where wound the other way; radius, middle and length in external radii.
@AddedLoops.cause(
    quantities=(
        normal("turns", "1", 0.1),
        Quantity("radius", "1", LogNormal(1.0, 0.5), 1.0, is_shape=True),
        Quantity("middle", "1", Normal(-0.5, 1.0), -0.5, is_shape=True),
        Quantity("length", "1", LogNormal(0.5, 1.0), 0.5, is_shape=True),
    ),
    starts=_hidden_places,
    can_begin=False,
    is_structural=True,
)
def hidden_winding(winding: Winding, rule: Rule, theta: Theta) -> tuple[Nodes, int]:
    """Another winding about the same axis carries the coil's current.

    Another winding about the same axis carries the same current, in either sense: a shield, a compensation, a second coil.

    Its numbers count in those of the coil: turns in the coil's turns, lengths in its external radius, heights from its front face.

    Source: wide: shields and compensations have a tenth of the turns and more.
    """
    nodes, weights = _gauss(HIDDEN_NODES, winding)
    turns, radius, middle, length = (theta[key][..., None] for key in ("turns", "radius", "middle", "length"))
    unit_m = winding.radius_m[..., None]
    weight = 0.5 * weights * turns * (winding.axial_loops * winding.radial_loops)[..., None]
    loops = _single_file(unit_m * (middle + 0.5 * length * nodes), unit_m * radius, weight)
    return loops, max(rule.steps, HIDDEN_STEPS)


def _gauss(n: int, winding: Winding) -> tuple[Tensor, Tensor]:
    """Gauss nodes from -1 to 1 and their weights, like the numbers of a winding."""
    nodes, weights = (torch.from_numpy(v).to(winding.radius_m) for v in np.polynomial.legendre.leggauss(n))
    return nodes, weights


def _single_file(*parts: Tensor) -> Nodes:
    """Heights, radii and weights of loops that follow one another along the axis."""
    height_m, radius_m, weight = torch.broadcast_tensors(*parts)
    return Nodes(height_m[..., None], radius_m[..., None], weight[..., None])
