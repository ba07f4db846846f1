"""Field of a winding: N_a x N_r loops in the frame of the coil, summed exactly or by a Gauss rule.

The coil frame sits on the front face; +z points away from the coil and the winding fills
-axial_pitch N_a <= z <= 0 between the inner radius R_c - radial_pitch N_r and the external radius R_c (paper, eq 9-10). Each loop lies
in the middle of its cell. The paper's square packing is axial_pitch = radial_pitch = 2 R_w.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import partial

import numpy as np
from jaxtyping import Float

from estimator.field.fused import fused_sum_of_loops, is_fusable
from estimator.field.kernel import POINTS_AT_ONCE, sum_of_loops
from estimator.field.loop import steps_for_ratio
from estimator.field.machine_code import is_plain, pays
from estimator.field.node_sum import Nodes, SumMode, sum_over_nodes, sum_to_first_order
from estimator.field.quadrature import discrete_gauss
from estimator.field.winding_shape import Rule, WindingShape
from estimator.tensors import Tensor, torch

# Keeps what torch and the slopes of loops need in between in the second-level cache of a processor.
ELEMENTS_PER_CHUNK = 32_768
# A graphics processor wants many at once; what is needed in between takes some 2 GB.
ELEMENTS_PER_CHUNK_ELSEWHERE = 2**24
POINTS_PER_EDGE = 6  # of a contour; its eight edges have the 48 points that `choose_rule` looks at


@dataclass(frozen=True)
class Winding(WindingShape):
    """Geometry of a coil's winding; every field may carry a batch.

    `radius_m` is the external radius R_c, `axial_loops` N_a and `radial_loops` N_r may be real numbers.
    """

    radius_m: Float[Tensor, "*batch"]
    axial_loops: Float[Tensor, "*batch"]
    radial_loops: Float[Tensor, "*batch"]
    axial_pitch_m: Float[Tensor, "*batch"]
    radial_pitch_m: Float[Tensor, "*batch"]

    @property
    def mean_radius_m(self) -> Float[Tensor, "*batch"]:
        """Mean of the loops' radii."""
        return self.radius_m - 0.5 * self.thickness_m

    @property
    def moment_m2(self) -> Float[Tensor, "*batch"]:
        """Magnetic moment per ampere: number of turns times the mean area of a loop."""
        rms2 = self.mean_radius_m**2 + self.radial_pitch_m**2 * (self.radial_loops**2 - 1.0) / 12.0
        return math.pi * rms2 * self.axial_loops * self.radial_loops

    def scaled(self, **factors: Tensor) -> Winding:
        """This winding with some of its numbers multiplied by factors, which may carry a batch."""
        numbers = (getattr(self, each.name) * factors.get(each.name, 1.0) for each in fields(self))
        return Winding(*torch.broadcast_tensors(*numbers))

    @property
    def half_width_m(self) -> Float[Tensor, "*batch"]:
        """The external radius."""
        return self.radius_m

    def distance_m(self, points_coil_m: Float[Tensor, "*#batch point 3"]) -> Float[Tensor, "*batch point"]:
        """Distance from points to the winding's cross-section; 0 inside it."""
        return distance_to_winding(points_coil_m, self)

    def full_rule(self, points_coil_m: Float[Tensor, "*batch point 3"]) -> Rule:
        """The rule that sums all loops of a winding with whole loop counts (the largest of its batch)."""
        return exact_rule(self, points_coil_m)

    def field_by(self, rule: Rule, mode: SumMode = SumMode.PLAIN) -> Callable[[Tensor], Tensor]:
        """Field of one ampere by a rule, in T/A, as a function of points in the coil frame; its loops are found once."""
        return partial(field_of_loops, loops=loops_of(self, rule), steps=rule.steps, mode=mode)

    def contour_m(self, distance_m: float) -> Float[Tensor, "point 3"]:
        """Points at one distance from the cross-section, all around it, in the half-plane of the coil frame that holds it."""
        inner_m, outer_m = float(self.radius_m - self.thickness_m), float(self.radius_m)
        length_m = float(self.length_m)
        along = torch.linspace(0.0, 1.0, POINTS_PER_EDGE, dtype=torch.float64)
        turn = 0.5 * math.pi * along
        rho_m = inner_m + (outer_m - inner_m) * along
        z_m = -length_m * along
        round_m, up_m = distance_m * torch.cos(turn), distance_m * torch.sin(turn)
        parts = [
            (rho_m, torch.full_like(rho_m, distance_m)),
            (rho_m, torch.full_like(rho_m, -length_m - distance_m)),
            (torch.full_like(z_m, outer_m + distance_m), z_m),
            (torch.full_like(z_m, inner_m - distance_m), z_m),
            *((outer_m + round_m, height_m) for height_m in (up_m, -length_m - up_m)),
            *((inner_m - round_m, height_m) for height_m in (up_m, -length_m - up_m)),
        ]
        rho_m, z_m = (torch.cat(coordinate) for coordinate in zip(*parts, strict=True))
        is_there = rho_m >= 0.0  # in a bore narrower than the distance there are no such points
        return torch.stack((rho_m, torch.zeros_like(rho_m), z_m), dim=-1)[is_there]


def winding_field_per_ampere(
    points_coil_m: Float[Tensor, "*#batch point 3"],
    winding: Winding,
    rule: Rule,
    mode: SumMode = SumMode.PLAIN,
) -> Float[Tensor, "*batch point 3"]:
    """Field of one ampere in the winding at points of the coil frame, by a chosen rule, in T/A.

    Args:
        points_coil_m: Points in the coil frame, outside the winding.
        winding: Geometry; its batch broadcasts with the points' batch.
        rule: Nodes and AGM steps, from `choose_rule` or `exact_rule`.
        mode: How loops are summed (`node_sum`).
    Returns: Bx, By, Bz in the coil frame per ampere; differentiable in points and geometry as `mode` allows.
    References: Osinde et al., eq 9-13, with the sum taken in Cartesian components (erratum to eq 13).
    Examples:
        >>> radius_m, loops, pitch_m = torch.tensor([0.051, 1.0, 2e-3], dtype=torch.float64)
        >>> loop = Winding(radius_m, loops, loops, pitch_m, pitch_m)  # one loop of radius 50 mm, 1 mm behind the face
        >>> centre = torch.tensor([[0.0, 0.0, -0.001]], dtype=torch.float64)
        >>> round(winding_field_per_ampere(centre, loop, exact_rule(loop, centre))[0, 2].item() * 1e6, 6)
        12.566371
    """
    return field_of_loops(points_coil_m, loops_of(winding, rule), rule.steps, mode)


def field_of_loops(
    points_coil_m: Float[Tensor, "*#batch point 3"], loops: Nodes, steps: int, mode: SumMode = SumMode.PLAIN
) -> Float[Tensor, "*batch point 3"]:
    """Field of weighted loops about the axis of a coil, in T per ampere.

    Args:
        points_coil_m: Points in the coil frame, not on a loop.
        loops: Heights, radii and weights on a grid of two node axes, after the batch.
        steps: AGM steps of each loop.
        mode: How loops are summed.
    """
    batch = np.broadcast_shapes(points_coil_m.shape[:-2], *(value.shape[:-2] for value in loops))
    n_points, n_nodes = points_coil_m.shape[-2], loops.weight.shape[-2:].numel()
    points = points_coil_m.expand(*batch, n_points, 3).reshape(-1, n_points, 3)
    rows = Nodes(*(v.expand(*batch, *v.shape[-2:]).reshape(-1, *v.shape[-2:]) for v in loops))
    if mode is SumMode.PLAIN and pays(0) and is_plain(points, *rows):
        return sum_of_loops(points, *rows.flat(), steps).reshape(*batch, n_points, 3)
    if mode is SumMode.PLAIN and is_fusable(points, *rows):
        return fused_sum_of_loops(points, *rows.flat(), steps).reshape(*batch, n_points, 3)
    node_sum = sum_to_first_order if mode is SumMode.FIRST_ORDER else sum_over_nodes
    chunk = ELEMENTS_PER_CHUNK if points.device.type == "cpu" else ELEMENTS_PER_CHUNK_ELSEWHERE
    n_row_parts = math.ceil(len(points) / max(1, chunk // (n_points * n_nodes)))
    n_point_parts = math.ceil(n_points / max(POINTS_AT_ONCE, chunk // n_nodes))
    field = []
    for row_points, *row_nodes in zip(
        *(value.tensor_split(n_row_parts) for value in (points, *rows)), strict=True
    ):
        point_parts = row_points.tensor_split(n_point_parts, dim=1)
        field.append(torch.cat([node_sum(part, Nodes(*row_nodes), steps) for part in point_parts], dim=1))
    return torch.cat(field).reshape(*batch, n_points, 3)


def loops_of(winding: Winding, rule: Rule) -> Nodes:
    """The weighted loops that stand for a winding, on a grid of axial and radial nodes after the winding's batch."""
    axial = discrete_gauss(winding.axial_loops, rule.axial_nodes)
    radial = discrete_gauss(winding.radial_loops, rule.radial_nodes)
    height_m = winding.axial_pitch_m[..., None] * axial.nodes - 0.5 * winding.length_m[..., None]
    radius_m = winding.mean_radius_m[..., None] + winding.radial_pitch_m[..., None] * radial.nodes
    weight = axial.weights[..., :, None] * radial.weights[..., None, :]
    return Nodes(height_m[..., :, None], radius_m[..., None, :], weight)


def exact_rule(winding: Winding, points_coil_m: Float[Tensor, "*batch point 3"]) -> Rule:
    """The rule that sums all loops of a winding with whole loop counts (the largest of its batch)."""
    steps = _steps(winding, points_coil_m)
    return Rule(int(winding.axial_loops.max().item()), int(winding.radial_loops.max().item()), steps)


def distance_to_winding(
    points_coil_m: Float[Tensor, "*#batch point 3"], winding: Winding
) -> Float[Tensor, "*batch point"]:
    """Distance from points to the winding's cross-section; 0 inside it."""
    rho_m = torch.sqrt(points_coil_m[..., 0] ** 2 + points_coil_m[..., 1] ** 2)
    z_m = points_coil_m[..., 2]
    inner_m = (winding.radius_m - winding.thickness_m)[..., None]
    radial = torch.maximum(inner_m - rho_m, rho_m - winding.radius_m[..., None]).clamp(min=0.0)
    axial = torch.maximum(-winding.length_m[..., None] - z_m, z_m).clamp(min=0.0)
    return torch.sqrt(radial**2 + axial**2)


def _steps(winding: Winding, points_coil_m: Float[Tensor, "*batch point 3"]) -> int:
    """AGM steps for the nearest of these points; the extreme loops lie in the corners of the cross-section."""
    with torch.no_grad():
        nearest_m = float(distance_to_winding(points_coil_m, winding).min())
        half_cell_m = 0.5 * float(torch.minimum(winding.axial_pitch_m, winding.radial_pitch_m).min())
        farthest_m = float((points_coil_m[..., :2].norm(dim=-1).max() + winding.radius_m.max()).item())
        return steps_for_ratio(max(nearest_m, 0.1 * half_cell_m) / farthest_m)
