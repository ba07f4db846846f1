"""How a real winding, with its leads and its core, differs from N_a x N_r equal circular loops."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from estimator.effects.base import Quantity, Theta, normal, shape
from estimator.effects.circumstances import Circumstances, Extent
from estimator.effects.stages import AddedLoops, SourceEffect, WindingEffect
from estimator.field.literal import literal_field_per_ampere
from estimator.field.node_sum import Nodes
from estimator.field.straight import MU0_OVER_4PI, segment_field
from estimator.field.winding import Rule, Winding, field_of_loops, loops_of
from estimator.rig.parameters import LogNormal
from estimator.tensors import Tensor, torch

POINTS_AT_ONCE = 1000  # in all of a batch: more would push the dozen arrays of an oval coil out of the cache
OVAL_NODES = 32  # along a loop; the trapezoidal rule converges geometrically on a closed smooth curve
LAYER_NODES = 8  # along the missing part of a layer


class PitchEffect(WindingEffect):
    """A pitch other than the rig file says."""

    can_begin: ClassVar[bool] = False

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether the rig file fixes the pitch; a free one's own prior bounds what can be built."""
        return not circumstances.rig.parameters[f"{place}.{self.name}_m"].is_free


class AxialPitch(PitchEffect):
    """The wire lies wider (or closer) along the axis than its diameter."""

    name: ClassVar[str] = "axial_pitch"
    words: ClassVar[str] = "turns lie wider along the axis than the wire is thick"
    source: ClassVar[str] = "play between turns of orthocyclic windings, 0 to 2 %"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Relative excess of the pitch."""
        return (normal("excess", "1", 0.02),)

    def apply(self, winding: Winding, theta: Theta) -> Winding:
        """The winding as it really is."""
        factor = 1.0 + theta["excess"]
        return winding.with_pitches(factor, torch.ones_like(factor))


class RadialPitch(PitchEffect):
    """Layers lie closer (or wider) than the wire is thick."""

    name: ClassVar[str] = "radial_pitch"
    words: ClassVar[str] = "layers lie closer than the wire is thick"
    source: ClassVar[str] = "layers in each other's grooves: up to 13 % closer; the MICE coils 39 %"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Relative excess of the pitch."""
        return (normal("excess", "1", 0.05),)

    def apply(self, winding: Winding, theta: Theta) -> Winding:
        """The winding as it really is."""
        factor = 1.0 + theta["excess"]
        return winding.with_pitches(torch.ones_like(factor), factor)


class TurnsGradient(AddedLoops):
    """Turns lie denser towards one end of the winding."""

    name: ClassVar[str] = "turns_gradient"
    words: ClassVar[str] = "turns lie denser towards one end"
    source: ClassVar[str] = "wide: hand-wound coils"
    can_begin: ClassVar[bool] = False

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Relative excess of turns per length at the front face."""
        return (normal("slope", "1", 0.05),)

    def loops(self, winding: Winding, rule: Rule, theta: Theta) -> tuple[Nodes, int]:
        """Loops that stand for the excess of turns."""
        loops = loops_of(winding, rule)
        half_m = 0.5 * winding.length_m[..., None, None]
        excess = theta["slope"][..., None, None] * (loops.height_m + half_m) / half_m
        return loops._replace(weight=loops.weight * excess), rule.steps


class ShortLayer(AddedLoops):
    """The outermost layer ends before the face of the winding."""

    name: ClassVar[str] = "short_layer"
    words: ClassVar[str] = "the outermost layer is not wound to its end"
    source: ClassVar[str] = "up to a whole layer may be missing"
    can_begin: ClassVar[bool] = False
    is_structural: ClassVar[bool] = True

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Share of the layer that is missing, and at which end."""
        return (normal("missing", "1", 0.5), shape("at_front", "1", 0.0, 1.0, is_fixed=True))

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """The two ends: front and back."""
        return ({"at_front": 1.0}, {"at_front": 0.0})

    def loops(self, winding: Winding, rule: Rule, theta: Theta) -> tuple[Nodes, int]:
        """Loops that stand for what is missing."""
        nodes, weights = (
            torch.from_numpy(v).to(winding.radius_m) for v in np.polynomial.legendre.leggauss(LAYER_NODES)
        )
        share, at_front = theta["missing"][..., None], theta["at_front"][..., None]
        depth = 0.5 * (nodes + 1.0) * share  # from the end, in units of the length
        height_m = -winding.length_m[..., None] * torch.where(at_front > 0.5, depth, 1.0 - depth)
        radius_m = (winding.radius_m - 0.5 * winding.radial_pitch_m)[..., None]
        weight = -0.5 * weights * share * winding.axial_loops[..., None]
        height_m, radius_m, weight = torch.broadcast_tensors(height_m, radius_m, weight)
        return Nodes(height_m[..., None], radius_m[..., None], weight[..., None]), rule.steps


class CoilOvality(SourceEffect):
    """Loops are ellipses: r = a (1 + e cos 2(phi - phi0))."""

    name: ClassVar[str] = "coil_ovality"
    words: ClassVar[str] = "the loops are oval"
    source: ClassVar[str] = "a coil pressed in a vice or wound on a printed former, 0 to 2 %"
    is_structural: ClassVar[bool] = True

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Cosine and sine part of the relative change of radius."""
        return (normal("cos2", "1", 0.01), normal("sin2", "1", 0.01))

    def apply(
        self, points_coil_m: Float[Tensor, "*#batch pose 3"], winding: Winding, rule: Rule, theta: Theta
    ) -> Float[Tensor, "*#batch pose 3"]:
        """Field of oval minus round loops per ampere, to first order in the ovality, by Biot and Savart on few loops."""
        batch = torch.broadcast_shapes(points_coil_m.shape[:-2], winding.radius_m.shape)
        n_points = max(1, POINTS_AT_ONCE // math.prod(batch))
        parts = [
            self._apply(some_m, winding, rule, theta) for some_m in points_coil_m.split(n_points, dim=-2)
        ]
        return parts[0] if len(parts) == 1 else torch.cat(parts, dim=-2)

    def _apply(
        self, points_coil_m: Float[Tensor, "*#batch pose 3"], winding: Winding, rule: Rule, theta: Theta
    ) -> Float[Tensor, "*#batch pose 3"]:
        """Field of oval minus round loops at few points."""
        few = Rule(min(rule.axial_nodes, 4), min(rule.radial_nodes, 2), rule.steps)
        loops = torch.broadcast_tensors(*loops_of(winding, few))
        height, radius, weight = (value.flatten(-2) for value in loops)
        phi = (
            2.0
            * math.pi
            * torch.arange(OVAL_NODES, dtype=points_coil_m.dtype, device=points_coil_m.device)
            / OVAL_NODES
        )
        cos, sin = torch.cos(phi), torch.sin(phi)
        swell = theta["cos2"][..., None] * torch.cos(2.0 * phi) + theta["sin2"][..., None] * torch.sin(
            2.0 * phi
        )
        turn = 2.0 * (
            theta["sin2"][..., None] * torch.cos(2.0 * phi) - theta["cos2"][..., None] * torch.sin(2.0 * phi)
        )
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


class WindingSheared(SourceEffect):
    """Loops lean: each stands across the axis, but their centres run away from it with the height."""

    name: ClassVar[str] = "winding_sheared"
    words: ClassVar[str] = "the winding leans: its loops' centres shift with the height"
    source: ClassVar[str] = (
        "turns that slipped on a former, or a former printed askew: 0.2 to 1 mm over 50 mm"
    )
    is_structural: ClassVar[bool] = True

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Shift along x and y per height above the middle of the winding."""
        return (normal("shear_x", "1", 0.02), normal("shear_y", "1", 0.02))

    def apply(
        self, points_coil_m: Float[Tensor, "*#batch pose 3"], winding: Winding, rule: Rule, theta: Theta
    ) -> Float[Tensor, "*#batch pose 3"]:
        """Field of shifted less upright loops per ampere; the layers of one height are one row of the sum."""
        loops = loops_of(winding, rule)
        above_m = loops.height_m[..., 0] + 0.5 * winding.length_m[..., None]
        x_m, y_m = (theta[f"shear_{axis}"][..., None] * above_m for axis in "xy")
        shift_m = torch.stack(torch.broadcast_tensors(x_m, y_m, torch.zeros_like(above_m)), dim=-1)
        at_height = Nodes(
            loops.height_m[..., None], loops.radius_m[..., None, :, :], loops.weight[..., None, :]
        )
        of_heights = field_of_loops(
            points_coil_m[..., None, :, :] - shift_m[..., None, :], at_height, rule.steps
        )
        return of_heights.sum(-3) - field_of_loops(points_coil_m, loops, rule.steps)


class LeadWire(SourceEffect):
    """The two leads run straight out from the middle of the winding, apart along the axis instead of twisted."""

    name: ClassVar[str] = "lead_wire"
    words: ClassVar[str] = "the leads run out of the winding apart instead of twisted"
    source: ClassVar[str] = "leads lie some millimetres to centimetres apart over 0.1 to 0.5 m"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Distance of the leads (positive: the current runs out on the side of the front face), azimuth and length."""
        return (
            normal("gap_m", "m", 0.01),
            shape("azimuth_rad", "rad", -2.0 * math.pi, 2.0 * math.pi),
            Quantity("length_m", "m", LogNormal(0.2, 0.7), 0.2, is_shape=True),
        )

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Azimuths all around the axis."""
        return tuple({"azimuth_rad": math.pi * i / 4.0, "length_m": 0.2} for i in range(-3, 5))

    def apply(
        self, points_coil_m: Float[Tensor, "*#batch pose 3"], winding: Winding, rule: Rule, theta: Theta
    ) -> Float[Tensor, "*#batch pose 3"]:
        """Field of the rectangle of wire per ampere."""
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


def _rod_per_moment(
    points_coil_m: Float[Tensor, "*#batch pose 3"], winding: Winding
) -> Float[Tensor, "*#batch pose 3"]:
    """Field of a rod in the bore, as long as the winding and magnetised along the axis, in units of the winding's own moment."""
    pole = (MU0_OVER_4PI * winding.moment_m2 / winding.length_m)[..., None, None]
    front = points_coil_m
    length_m = winding.length_m[..., None]
    back = torch.stack(
        torch.broadcast_tensors(front[..., 0], front[..., 1], front[..., 2] + length_m), dim=-1
    )
    field: Tensor = (
        front / front.norm(dim=-1, keepdim=True) ** 3 - back / back.norm(dim=-1, keepdim=True) ** 3
    )
    return pole * field


class IronCore(SourceEffect):
    """Iron in the bore adds a moment along the axis, proportional to the current."""

    name: ClassVar[str] = "iron_core"
    words: ClassVar[str] = "iron in the bore adds to the coil's moment"
    source: ClassVar[str] = "wide: a screw adds per mille, a core multiplies"
    is_structural: ClassVar[bool] = True

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Moment of the rod in units of the winding's."""
        return (normal("share", "1", 0.1),)

    def apply(
        self, points_coil_m: Float[Tensor, "*#batch pose 3"], winding: Winding, rule: Rule, theta: Theta
    ) -> Float[Tensor, "*#batch pose 3"]:
        """Field of the rod per ampere."""
        return theta["share"][..., None, None] * _rod_per_moment(points_coil_m, winding)


class CoreSaturation(SourceEffect):
    """Iron in the bore that gives less the more current flows."""

    name: ClassVar[str] = "core_saturation"
    words: ClassVar[str] = "iron in the bore saturates"
    source: ClassVar[str] = "wide: a core in a coil of some amperes may lose any part of its moment"
    is_structural: ClassVar[bool] = True
    is_linear: ClassVar[bool] = False

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Moment at small current in units of the winding's, and its loss per square ampere."""
        loss = 0.05 / extent.largest_current_A**2
        return (normal("share", "1", 0.1), normal("loss_per_A2", "1/A2", loss))

    def apply(
        self, points_coil_m: Float[Tensor, "*#batch pose 3"], winding: Winding, rule: Rule, theta: Theta
    ) -> Float[Tensor, "*#batch pose 3"]:
        """Field of a rod with the winding's moment."""
        return _rod_per_moment(points_coil_m, winding)

    def drive(
        self, current_A: Float[Tensor, "*#batch reading"], theta: Theta
    ) -> Float[Tensor, "*#batch reading"]:
        """Moment of the rod over that of the winding at one ampere."""
        share, loss = theta["share"][..., None], theta["loss_per_A2"][..., None]
        return (share - loss * current_A**2) * current_A


class SphericalSum(SourceEffect):
    """Readings and simulation differ by the paper's literal sum, which adds spherical components of loops whose centres differ.

    A weight of 1 stands for readings that a literal simulation made. Where the simulation itself is literal (`field_sum:
    spherical_components` in the rig file), a weight of -1 takes that back: nature adds vectors.
    """

    name: ClassVar[str] = "spherical_sum"
    words: ClassVar[str] = (
        "readings and simulation differ by a sum of spherical components about different centres"
    )
    source: ClassVar[str] = (
        "0, 1 or -1: which simulation made the data, and which one explains them (Osinde et al., eq 13)"
    )
    can_begin: ClassVar[bool] = False

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Weight of the literal sum against the right one."""
        return (normal("weight", "1", 1.0),)

    def apply(
        self, points_coil_m: Float[Tensor, "*#batch pose 3"], winding: Winding, rule: Rule, theta: Theta
    ) -> Float[Tensor, "*#batch pose 3"]:
        """Literal less right sum, per ampere."""
        right = field_of_loops(points_coil_m, loops_of(winding, rule), rule.steps)
        literal = literal_field_per_ampere(points_coil_m, winding, rule)
        return theta["weight"][..., None, None] * (literal - right)


class DipoleModel(SourceEffect):
    """The readings follow a point dipole at the middle of the winding instead of loops."""

    name: ClassVar[str] = "dipole_model"
    words: ClassVar[str] = "the readings follow a point dipole, not a winding"
    source: ClassVar[str] = "0 or 1: which simulation made the data"
    can_begin: ClassVar[bool] = False

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Weight of the dipole against the loops."""
        return (normal("weight", "1", 1.0),)

    def apply(
        self, points_coil_m: Float[Tensor, "*#batch pose 3"], winding: Winding, rule: Rule, theta: Theta
    ) -> Float[Tensor, "*#batch pose 3"]:
        """Dipole less winding, per ampere."""
        moment = winding.moment_m2[..., None]
        x, y = points_coil_m[..., 0], points_coil_m[..., 1]
        z = points_coil_m[..., 2] + 0.5 * winding.length_m[..., None]
        r2 = x**2 + y**2 + z**2
        common = MU0_OVER_4PI * moment * r2**-2.5
        dipole = torch.stack(
            torch.broadcast_tensors(3 * x * z * common, 3 * y * z * common, (3 * z**2 - r2) * common), dim=-1
        )
        loops = field_of_loops(points_coil_m, loops_of(winding, rule), rule.steps)
        return theta["weight"][..., None, None] * (dipole - loops)
