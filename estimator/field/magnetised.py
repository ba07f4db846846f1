"""Field of a winding whose wire is magnetised: rings of dipoles about the axis of a coil."""

from __future__ import annotations

import math
from dataclasses import dataclass

from jaxtyping import Float
from numpy.polynomial.legendre import leggauss

from estimator.field.kernel import sums_of_rings
from estimator.field.loop import NEAREST_STEPS, loop_terms
from estimator.field.machine_code import is_plain
from estimator.field.node_sum import carrying_first_order, loop_slopes
from estimator.field.winding import Winding
from estimator.tensors import Tensor, torch
from estimator.units import MU0_T_M_PER_A

# Nodes along a winding: at least, and more per inner radius of its length.
FEWEST_AXIAL, AXIAL_PER_RADIUS = 4, 3.0
FEWEST_RADIAL, RADIAL_PER_RADIUS = 1, 4.0
CORNER_NODES = 8  # each way, in each of the four parts into which a point cuts a winding's cross-section
# Distance of the two loops whose difference stands for a ring of dipoles, over the ring's radius.
DIFFERENCE_STEP = 1e-5
POINTS_AT_ONCE = 2048  # whose factors are kept for every ring, which bounds the memory


@dataclass(frozen=True)
class Rings:
    """Nodes and weights of a Gauss rule over the cross-section of a winding; each node is a ring of dipoles.

    Attributes:
        radius_m, height_m: Nodes in the coil frame.
        area_m2: Weights: the part of the cross-section that each ring stands for.
    """

    radius_m: Float[Tensor, " ring"]
    height_m: Float[Tensor, " ring"]
    area_m2: Float[Tensor, " ring"]

    def to(self, device: torch.device) -> Rings:
        """These rings on another device."""
        return Rings(self.radius_m.to(device), self.height_m.to(device), self.area_m2.to(device))

    @classmethod
    def of(cls, winding: Winding) -> Rings:
        """Rings that suffice a third of the inner radius away from the winding: error 1e-3 of the added field, less farther away.

        Args:
            winding: One winding (no batch).
        """
        length_m, thickness_m = float(winding.length_m), float(winding.thickness_m)
        inner_m = float(winding.radius_m) - thickness_m
        n_axial = FEWEST_AXIAL + math.ceil(AXIAL_PER_RADIUS * length_m / inner_m)
        n_radial = FEWEST_RADIAL + math.ceil(RADIAL_PER_RADIUS * thickness_m / inner_m)
        height_m, along_m = _gauss(-length_m, 0.0, n_axial)
        radius_m, across_m = _gauss(inner_m, inner_m + thickness_m, n_radial)
        radius_m, height_m = (grid.flatten() for grid in torch.meshgrid(radius_m, height_m, indexing="ij"))
        return cls(radius_m, height_m, (across_m[:, None] * along_m).flatten())


def field_of_rings(
    points_coil_m: Float[Tensor, "*batch point 3"],
    rings: Rings,
    magnetisation_T: Float[Tensor, "pattern ring 2"],
    steps: int = NEAREST_STEPS,
) -> Float[Tensor, "*batch point pattern 3"]:
    """Field of a magnetised winding, for several patterns of magnetisation at once.

    A ring magnetised along the axis is the difference of a larger and a smaller loop; one magnetised outwards is the difference of a lower
    and a higher loop.

    Args:
        points_coil_m: Points in the coil frame, outside the winding.
        rings: Rings of the winding.
        magnetisation_T: mu0 M of each ring, outwards and along the axis.
        steps: AGM steps of each loop, as a rule of the winding for the same points has them.
    Returns: Flux density in the coil frame, in tesla.
    References: Jackson, Classical Electrodynamics, 3rd ed., section 5.8 (magnetisation and its currents).

    A ring far away is a dipole along the axis:

    >>> import torch
    >>> ring = Rings(*torch.tensor([[0.1], [0.0], [1e-4]], dtype=torch.float64))
    >>> point_m = torch.tensor([[0.0, 0.0, 10.0]], dtype=torch.float64)
    >>> field_T = field_of_rings(point_m, ring, torch.tensor([[[0.0, 1.0]]], dtype=torch.float64))[0, 0, 2].item()
    >>> bool(abs(field_T / (2.0 * 2.0 * math.pi * 0.1 * 1e-4 / (4.0 * math.pi * 10.0**3)) - 1.0) < 1e-3)
    True
    """
    if is_plain(points_coil_m):
        return _in_machine_code(points_coil_m, rings, magnetisation_T, steps)
    # The two loops differ by less than single precision shows.
    x, y, z = points_coil_m.double()[..., None].unbind(-2)
    step_m = DIFFERENCE_STEP * rings.radius_m
    radial_A, axial_A = (magnetisation_T * (rings.area_m2 / step_m)[:, None] / MU0_T_M_PER_A).unbind(-1)
    ring, wider, higher = (
        loop_terms(x, y, z - height, radius, steps)
        for height, radius in (
            (rings.height_m, rings.radius_m),
            (rings.height_m, rings.radius_m + step_m),
            (rings.height_m + step_m, rings.radius_m),
        )
    )
    h, axial = (
        (of_wider - of_ring) @ axial_A.T - (of_higher - of_ring) @ radial_A.T
        for of_ring, of_wider, of_higher in zip(ring, wider, higher, strict=True)
    )
    return torch.stack((x * h, y * h, axial), dim=-1).to(points_coil_m.dtype)


def field_of_rings_to_first_order(
    points_coil_m: Float[Tensor, "*batch point 3"],
    rings: Rings,
    magnetisation_T: Float[Tensor, "pattern ring 2"],
    steps: int = NEAREST_STEPS,
) -> Float[Tensor, "*batch point pattern 3"]:
    """Field of rings of dipoles in the coil frame, in T, with first derivatives in the points, but without second ones.

    Args:
        points_coil_m, rings, magnetisation_T, steps: As in `field_of_rings`.
    """
    points_m = (
        points_coil_m.double().flatten(0, -3) if points_coil_m.ndim > 2 else points_coil_m.double()[None]
    )
    field = carrying_first_order(points_m[:, None], _sums(points_m.detach(), rings, magnetisation_T, steps))
    return field.transpose(-3, -2).reshape(*points_coil_m.shape[:-1], -1, 3).to(points_coil_m.dtype)


def _in_machine_code(points_coil_m: Tensor, rings: Rings, magnetisation_T: Tensor, steps: int) -> Tensor:
    """Values of the field to first order: differences of loops magnify rounding, and both are to be the same."""
    parts = []
    for points_m in points_coil_m.reshape(1, -1, 3).split(POINTS_AT_ONCE, dim=-2):
        h, axial = _sums(points_m, rings, magnetisation_T, steps)[..., 0, :].unbind(0)
        x, y = points_m[:, None, :, 0], points_m[:, None, :, 1]
        parts.append(torch.stack((x * h, y * h, axial), dim=-1))  # row, pattern, point, axis
    field = torch.cat(parts, dim=-2)[0].transpose(0, 1)
    return field.reshape(*points_coil_m.shape[:-1], -1, 3)


def _sums(points_m: Tensor, rings: Rings, magnetisation_T: Tensor, steps: int) -> Tensor:
    """The two factors of the field of each pattern, and their slopes along z: by factor, row, pattern, value and slope, point."""
    step_m = DIFFERENCE_STEP * rings.radius_m
    radial_A, axial_A = (magnetisation_T * (rings.area_m2 / step_m)[:, None] / MU0_T_M_PER_A).unbind(-1)
    if is_plain(points_m):
        return sums_of_rings(points_m, rings.height_m, rings.radius_m, step_m, axial_A, radial_A, steps)
    height_m = torch.cat((rings.height_m, rings.height_m, rings.height_m + step_m))
    radius_m = torch.cat((rings.radius_m, rings.radius_m + step_m, rings.radius_m))
    rows = (len(points_m), len(height_m))
    of_each = loop_slopes(points_m, height_m.expand(rows), radius_m.expand(rows), steps)[:, :, :2]
    # Differences first: sums of many loops would round by as much as their difference is worth.
    ring, wider, higher = of_each.chunk(3, dim=-2)
    total: Tensor = axial_A @ (wider - ring) - radial_A @ (higher - ring)
    return total.transpose(-3, -2)


def field_inside_per_ampere(winding: Winding, rings: Rings) -> Float[Tensor, "ring 2"]:
    """Field of one ampere in a winding at rings inside its cross-section, outwards and along the axis.

    The current is spread evenly over the cross-section. Each ring cuts it into four parts with a Gauss rule each, so that the steep part of
    the integrand lies in their corners.
    """
    inner_m = float(winding.radius_m - winding.thickness_m)
    density_per_m2 = float(
        winding.axial_loops * winding.radial_loops / (winding.length_m * winding.thickness_m)
    )
    total = torch.zeros(len(rings.radius_m), 2, dtype=torch.float64)
    for i, (radius_m, height_m) in enumerate(
        zip(rings.radius_m.tolist(), rings.height_m.tolist(), strict=True)
    ):
        for low_m, high_m in ((inner_m, radius_m), (radius_m, float(winding.radius_m))):
            for back_m, front_m in ((-float(winding.length_m), height_m), (height_m, 0.0)):
                a, da = _gauss(low_m, high_m, CORNER_NODES)
                z, dz = _gauss(back_m, front_m, CORNER_NODES)
                x = torch.tensor(radius_m, dtype=torch.float64)
                h, axial = loop_terms(x, torch.zeros_like(x), height_m - z[:, None], a, NEAREST_STEPS)
                weight = density_per_m2 * dz[:, None] * da
                total[i] += torch.stack(((radius_m * h * weight).sum(), (axial * weight).sum()))
    return total


def _gauss(low: float, high: float, n: int) -> tuple[Tensor, Tensor]:
    """Gauss-Legendre nodes and weights between two ends."""
    nodes, weights = (torch.from_numpy(values) for values in leggauss(n))
    return low + 0.5 * (high - low) * (nodes + 1.0), 0.5 * (high - low) * weights
