"""Field of an iron core in the bore of a coil, and how its parts demagnetise each other.

A core is a cylinder about the coil's axis. Along the axis its polarisation is given at some heights and runs straight between them. Since
flux neither begins nor ends in soft iron, it fans out where it falls off: the polarisation outwards is `-r/2` times its slope, all charge
sits on the surface, and a dozen numbers do what slices of even polarisation would need hundreds for. Across the axis it is even in all
of the core. Each of these is a pattern, one tesla strong.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

from jaxtyping import Float
from numpy.polynomial.legendre import leggauss

from estimator.field.loop import NEAREST_STEPS, loop_terms
from estimator.tensors import Tensor, torch
from estimator.units import MU0_T_M_PER_A

BANDS = 8  # between heights; 6 have an error of 0.8 % on the axis, 8 of 0.4 %
HEIGHTS = BANDS + 1
PATTERNS = HEIGHTS + 2  # and across the axis, along x and y
LOOPS_PER_BAND, LOOPS_PER_HEIGHT = 2, 2
ACROSS_HEIGHTS, ACROSS_AROUND = 8, 4  # dipoles that point across the axis
ANGLES = 32  # of the integrals over disks and bands


@dataclass(frozen=True)
class Core:
    """A cylinder of iron about a coil's axis; every field may carry a batch.

    Attributes:
        radius_m, length_m: Of the cylinder.
        front_m: Height of its front face in the coil frame; at 0 it is level with the winding's.
        strength: 0 is no iron, 1 iron of unlimited permeability (`saturation.polarisation_T`).
        saturation_T: Polarisation that it cannot exceed.
    """

    radius_m: Float[Tensor, "*batch"]
    length_m: Float[Tensor, "*batch"]
    front_m: Float[Tensor, "*batch"]
    strength: Float[Tensor, "*batch"]
    saturation_T: Float[Tensor, "*batch"]

    @property
    def heights_m(self) -> Float[Tensor, "*batch height"]:
        """Heights at which the polarisation along the axis is given, in m in the coil frame, from the back face to the front."""
        share = torch.arange(HEIGHTS).to(self.length_m) / BANDS
        return self.front_m[..., None] - self.length_m[..., None] * (1.0 - share)


def field_of_core(
    points_coil_m: Float[Tensor, "*#batch point 3"],
    radius_m: Float[Tensor, "*#batch"],
    length_m: Float[Tensor, "*#batch"],
    front_m: Float[Tensor, "*#batch"],
) -> Float[Tensor, "*batch point pattern 3"]:
    """Flux density of each pattern outside a core, in the coil frame, in tesla per tesla.

    Along the axis a polarisation is a sheet of current around the core, and where it fans out otherwise than before, a disk of current.
    Across the axis it is a heap of dipoles.

    Args:
        points_coil_m: Outside the core, half a band's length away or more.
        radius_m, length_m, front_m: Of the core.
    References: Jackson, Classical Electrodynamics, 3rd ed., section 5.8 (currents of a magnetisation) and 5.6 (dipoles).

    A core that is evenly magnetised along its axis is a dipole from afar:

    >>> radius_m, length_m, front_m = torch.tensor([0.01, 0.06, 0.03], dtype=torch.float64)
    >>> point_m = torch.tensor([[0.0, 0.0, 10.0]], dtype=torch.float64)
    >>> field_T = field_of_core(point_m, radius_m, length_m, front_m)[0, :HEIGHTS, 2].sum().item()
    >>> bool(abs(field_T / (math.pi * 0.01**2 * 0.06 / (2.0 * math.pi * 10.0**3)) - 1.0) < 1e-4)
    True
    """
    along = _along(points_coil_m, radius_m, length_m, front_m)
    return torch.cat((along, _across(points_coil_m, radius_m, length_m, front_m)), dim=-2)


def demagnetisation(
    radius_m: Float[Tensor, "*batch"], length_m: Float[Tensor, "*batch"]
) -> Float[Tensor, "*batch pattern pattern"]:
    """Field mu0 H against each pattern, averaged over its part of the core, per tesla in each pattern.

    The charge of a pattern sits on bands around the core and on its two faces. The mean potentials of bands and disks on each other are
    integrals over x = 0..pi of closed forms, with b = 2 sin(x/2), R = sqrt(t^2 + b^2) and all lengths in radii: between disks
    `4 sin^2 x / (t + R)`, from a disk to a ring `R - t`, between rings `1 / R`, the last two integrated along the bands. Across the axis
    and along it, the factors of an evenly magnetised body add up to 1.

    References: Chen, Brug and Goldfarb, IEEE Trans. Magn. 27, 3601 (1991), whose factors follow.
    """
    band = (length_m / (BANDS * radius_m))[..., None]
    between_bands, band_to_disk, between_disks = _potentials(band * torch.arange(BANDS + 1).to(length_m))
    inner, first = between_bands[..., 1:-1], between_bands[..., :1]
    beside = between_bands[..., 2:] + between_bands[..., :-2] - 2.0 * inner
    second = torch.cat((2.0 * (between_bands[..., 1:2] - first), beside), dim=-1)
    number = torch.arange(BANDS, device=length_m.device)
    bands = second[..., (number[:, None] - number).abs()]
    to_back = band_to_disk.diff(dim=-1)
    to_faces = torch.stack((to_back, to_back.flip(-1)), dim=-1)
    near, far = between_disks[..., :1], between_disks[..., -1:]
    faces = torch.stack((torch.cat((near, far), -1), torch.cat((far, near), -1)), dim=-2)
    potential = torch.cat(
        (torch.cat((bands, to_faces), dim=-1), torch.cat((to_faces.mT, faces), dim=-1)), dim=-2
    )
    slope = torch.eye(HEIGHTS).to(length_m).diff(dim=0)
    ends = torch.zeros(2, HEIGHTS).to(length_m)
    ends[0, 0], ends[1, -1] = -1.0, 1.0
    charge = torch.cat((-slope / band[..., None], ends.expand(*band.shape[:-1], 2, HEIGHTS)), dim=-2)
    along = charge.mT @ potential @ charge / (4.0 * band[..., None] * share_of_heights(band)[:, None])
    even = (near - far) / (2.0 * BANDS * band)  # of a core that is evenly magnetised along the axis
    across = torch.diag_embed((0.5 * (1.0 - even)).expand(*even.shape[:-1], 2))
    corner = torch.zeros(*even.shape[:-1], HEIGHTS, 2).to(length_m)
    return torch.cat((torch.cat((along, corner), -1), torch.cat((corner.mT, across), -1)), dim=-2)


def share_of_heights(like: Tensor) -> Float[Tensor, " height"]:
    """Length that each height stands for, in bands; of the kind of another tensor."""
    share = like.new_ones(HEIGHTS)
    share[0] = share[-1] = 0.5
    return share


def _potentials(
    distance: Float[Tensor, "*batch distance"],
) -> tuple[
    Float[Tensor, "*batch distance"], Float[Tensor, "*batch distance"], Float[Tensor, "*batch distance"]
]:
    """Mean potentials at some distances in radii: between rings integrated twice, between a ring and a disk once, between disks."""
    nodes, weights = _unit_gauss(ANGLES, distance)
    x, dx = math.pi * nodes**2, 2.0 * nodes * weights  # crowded where b is small
    b, t = 2.0 * torch.sin(0.5 * x), distance[..., None]
    r = torch.sqrt(t**2 + b**2)
    arc = torch.asinh(t / b)
    return (
        ((t * arc - r) * dx).sum(-1),
        ((0.5 * (t * r + b**2 * arc) - 0.5 * t**2) * dx).sum(-1),
        ((4.0 * torch.sin(x) ** 2 / (t + r)) * dx).sum(-1),
    )


def _along(points_m: Tensor, radius_m: Tensor, length_m: Tensor, front_m: Tensor) -> Tensor:
    """Field of the patterns along the axis."""
    nodes, weights = _unit_gauss(LOOPS_PER_BAND, length_m)
    band_m = (length_m / BANDS)[..., None]
    back_m, radius_m = (front_m - length_m)[..., None], radius_m[..., None]
    number = torch.arange(BANDS).to(length_m)
    sheet_m = back_m + band_m * (number[:, None] + nodes).flatten()
    sheet_A = band_m * weights.repeat(BANDS) / MU0_T_M_PER_A
    radii, steps = _unit_gauss(LOOPS_PER_HEIGHT, length_m)
    disk_m = back_m + band_m * torch.arange(HEIGHTS).to(length_m).repeat_interleave(LOOPS_PER_HEIGHT)
    disk_A = -0.5 * radius_m**2 / band_m * (radii * steps).repeat(HEIGHTS) / MU0_T_M_PER_A
    height_m = torch.cat((sheet_m, disk_m), dim=-1)
    of_disks = (radius_m * radii.repeat(HEIGHTS)).expand(disk_m.shape)
    loop_m = torch.cat((radius_m.expand(sheet_m.shape), of_disks), dim=-1)
    # How much of each loop's current belongs to each pattern: hats on the sheet, differences of slopes on the disks.
    hats = torch.zeros(BANDS, LOOPS_PER_BAND, HEIGHTS).to(length_m)
    rows = torch.arange(BANDS, device=length_m.device)
    hats[rows, :, rows] = 1.0 - nodes
    hats[rows, :, rows + 1] = nodes
    slope = torch.nn.functional.pad(torch.eye(HEIGHTS).to(length_m).diff(dim=0), (0, 0, 1, 1))
    bends = slope.diff(dim=0).repeat_interleave(LOOPS_PER_HEIGHT, dim=0)
    current_A = torch.cat((sheet_A, disk_A), dim=-1)[..., None] * torch.cat((hats.flatten(0, 1), bends))
    x, y, z = points_m[..., None].unbind(-2)
    h, axial = loop_terms(x, y, z - height_m[..., None, :], loop_m[..., None, :], NEAREST_STEPS)
    h, axial = h @ current_A, axial @ current_A
    return torch.stack((x * h, y * h, axial), dim=-1)


def _across(points_m: Tensor, radius_m: Tensor, length_m: Tensor, front_m: Tensor) -> Tensor:
    """Field of the patterns across the axis, by dipoles that are exact for fields of third degree across the core."""
    nodes, weights = _unit_gauss(ACROSS_HEIGHTS, length_m)
    turn = 2.0 * math.pi * (torch.arange(ACROSS_AROUND).to(length_m) + 0.5) / ACROSS_AROUND
    beside = math.sqrt(0.5) * torch.stack((torch.cos(turn), torch.sin(turn), 0.0 * turn), dim=-1)
    up = torch.tensor([0.0, 0.0, 1.0]).to(length_m)
    height_m = front_m[..., None, None, None] - length_m[..., None, None, None] * nodes[:, None, None]
    at_m = (height_m * up + radius_m[..., None, None, None] * beside).flatten(-3, -2)
    share = weights.repeat_interleave(ACROSS_AROUND) / ACROSS_AROUND
    volume_m3 = (math.pi * radius_m**2 * length_m)[..., None, None] * share
    arm_m = points_m[..., None, :] - at_m[..., None, :, :]
    r2 = (arm_m**2).sum(-1)
    far = 3.0 * volume_m3 * r2**-2.5
    tensor = (far[..., None, None] * arm_m[..., :2, None] * arm_m[..., None, :]).sum(-3)
    near = (volume_m3 * r2**-1.5).sum(-1)[..., None, None] * torch.eye(3).to(length_m)[:2]
    return (tensor - near) / (4.0 * math.pi)


def _unit_gauss(n: int, like: Tensor) -> tuple[Tensor, Tensor]:
    """Gauss-Legendre nodes and weights between 0 and 1, of the kind of another tensor."""
    nodes, weights = _nodes(n)
    return nodes.to(like), weights.to(like)


@cache
def _nodes(n: int) -> tuple[Tensor, Tensor]:
    """Gauss-Legendre nodes and weights between 0 and 1, in double precision on the processor."""
    nodes, weights = (torch.from_numpy(values) for values in leggauss(n))
    return 0.5 * (nodes + 1.0), 0.5 * weights
