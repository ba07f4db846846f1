"""Field of a winding whose wire is magnetised: rings of dipoles about the axis of a coil."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from numpy.polynomial.legendre import leggauss
from torch import Tensor

from estimator.field.loop import loop_terms
from estimator.field.winding import Winding
from estimator.units import MU0_T_M_PER_A

FEWEST_AXIAL, AXIAL_PER_RADIUS = 4, 3.0  # nodes along a winding, and for each inner radius of its length
FEWEST_RADIAL, RADIAL_PER_RADIUS = 1, 4.0
CORNER_NODES = 8  # each way, in the four parts into which a point inside a winding cuts it
STEP = 1e-5  # of a ring's radius: differences of loops that stand for its dipoles
STEPS = 7  # of the arithmetic-geometric mean: enough next to a ring


@dataclass(frozen=True)
class Rings:
    """Places in the cross-section of a winding, each for a part of its area: a Gauss rule.

    Attributes:
        radius_m, height_m: Of the rings in the coil frame.
        area_m2: Of the cross-section that each stands for.
    """

    radius_m: Float[Tensor, " ring"]
    height_m: Float[Tensor, " ring"]
    area_m2: Float[Tensor, " ring"]

    @classmethod
    def of(cls, winding: Winding) -> Rings:
        """Enough for points that keep clear of the winding by a third of its inner radius: 1e-3 of what it adds, and better farther off.

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
) -> Float[Tensor, "*batch point pattern 3"]:
    """Field of a winding magnetised in some ways at once.

    A ring that is magnetised along the axis is a larger loop against a smaller one; one that is magnetised outwards is a lower loop
    against a higher one.

    Args:
        points_coil_m: Points in the coil frame, off the winding.
        rings: Of the winding.
        magnetisation_T: mu0 M, outwards and along the axis.
    Returns: Flux density in the coil frame, in tesla.
    References: Jackson, Classical Electrodynamics, 3rd ed., section 5.8 (magnetisation and its currents).

    A ring far away is a dipole along the axis:

    >>> import torch
    >>> one = torch.ones(1, dtype=torch.float64)
    >>> ring = Rings(0.1 * one, 0.0 * one, 1e-4 * one)
    >>> at = torch.tensor([[0.0, 0.0, 10.0]], dtype=torch.float64)
    >>> field_T = field_of_rings(at, ring, torch.tensor([[[0.0, 1.0]]], dtype=torch.float64))[0, 0, 2].item()
    >>> bool(abs(field_T / (2.0 * 2.0 * math.pi * 0.1 * 1e-4 / (4.0 * math.pi * 10.0**3)) - 1.0) < 1e-3)
    True
    """
    x, y, z = points_coil_m[..., None].unbind(-2)
    step_m = STEP * rings.radius_m
    radial_A, axial_A = (magnetisation_T * (rings.area_m2 / step_m)[:, None] / MU0_T_M_PER_A).unbind(-1)
    here, wider, higher = (
        loop_terms(x, y, z - height, radius, STEPS)
        for height, radius in (
            (rings.height_m, rings.radius_m),
            (rings.height_m, rings.radius_m + step_m),
            (rings.height_m + step_m, rings.radius_m),
        )
    )
    h, axial = (
        (out - in_) @ axial_A.T - (up - in_) @ radial_A.T
        for in_, out, up in zip(here, wider, higher, strict=True)
    )
    return torch.stack((x * h, y * h, axial), dim=-1)


def field_inside_per_ampere(winding: Winding, rings: Rings) -> Float[Tensor, "ring 2"]:
    """Field of one ampere in a winding at rings within its own cross-section, outwards and along the axis, of a smooth current.

    Each ring cuts the cross-section into four parts, so that what is steep next to it lies in their corners.
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
                h, axial = loop_terms(x, torch.zeros_like(x), height_m - z[:, None], a, STEPS)
                weight = density_per_m2 * dz[:, None] * da
                total[i] += torch.stack(((radius_m * h * weight).sum(), (axial * weight).sum()))
    return total


def _gauss(low: float, high: float, n: int) -> tuple[Tensor, Tensor]:
    """Nodes and weights between two ends."""
    nodes, weights = (torch.from_numpy(values) for values in leggauss(n))
    return low + 0.5 * (high - low) * (nodes + 1.0), 0.5 * (high - low) * weights
