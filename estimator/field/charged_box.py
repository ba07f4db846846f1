"""Static magnetic field inside a box with sources outside it, as that of magnetic charges on its surface (equivalent sources).

Small sources just beside the box, nearer than charges can be to each other, are multipoles at places of their own.

The field of any charges is free of divergence and curl where there are none. That of sources outside a closed surface is, inside, that of
a layer of charges on the surface, which fine points stand for. Their sum need not be zero: charges as on a conductor make no field inside,
so a sum of any size can be added without a change there.
"""

from __future__ import annotations

from functools import lru_cache

from jaxtyping import Float

from estimator.field.harmonics import exterior_field
from estimator.rig.charged_box import MULTIPOLE_DEGREE, Triple
from estimator.rig.harmonic_terms import terms
from estimator.tensors import Tensor, torch

# Amplitudes of a multipole by degree.
SIZES = [len(terms(degree)) for degree in range(1, MULTIPOLE_DEGREE + 1)]


@lru_cache(maxsize=32)
def charge_places(half_m: Triple, intervals: tuple[int, int, int]) -> Float[Tensor, "charge 3"]:
    """Grid points on the surface of a box about the origin.

    Args:
        half_m: Half of each edge.
        intervals: Along each edge.
    """
    numbers = [torch.arange(n + 1) for n in intervals]
    grid = torch.cartesian_prod(*numbers)
    last = torch.tensor(intervals)
    on_surface = ((grid == 0) | (grid == last)).any(-1)
    share = grid[on_surface].double() / last.double()
    return (2.0 * share - 1.0) * torch.tensor(half_m, dtype=torch.float64)


def charged_box_field(
    points_m: Float[Tensor, "*#batch point 3"],
    half_m: Triple,
    intervals: tuple[int, int, int],
    amplitudes: Float[Tensor, "*#batch charge"],
) -> Float[Tensor, "*batch point 3"]:
    """Field of charges on the surface of a box. Independent amplitudes of rms 1 have a field of rms 1 in its middle, however many they are.

    Args:
        points_m: From the middle of the box, inside it; charges are singular.
        half_m, intervals: As of `charge_places`.
        amplitudes: One for each charge.
    References: Blakely, Potential Theory in Gravity and Magnetic Applications (1995), chapter 2 (Green's equivalent layer) and 12
        (equivalent sources).
    Examples:
        >>> one = torch.zeros(8, dtype=torch.float64)
        >>> one[0] = 8**0.5
        >>> charged_box_field(torch.zeros(1, 3, dtype=torch.float64), (1.0, 1.0, 1.0), (1, 1, 1), one).norm()
        tensor(1., dtype=torch.float64)
    """
    places_m = charge_places(half_m, intervals)
    per_amplitude = places_m.norm(dim=-1).pow(-4).sum().rsqrt().item()
    from_charge_m = points_m[..., :, :, None] - places_m.to(points_m).mT
    distance_m = from_charge_m.norm(dim=-2, keepdim=True)
    return torch.einsum("...pxc,...c->...px", from_charge_m / distance_m**3, per_amplitude * amplitudes)


def multipole_field(
    points_m: Float[Tensor, "*#batch point 3"],
    places_m: Float[Tensor, "multipole 3"],
    gaps_m: Float[Tensor, " multipole"],
    amplitudes: Float[Tensor, "*#batch amplitude"],
) -> Float[Tensor, "*batch point 3"]:
    """Field of dipoles and quadrupoles. Independent amplitudes of rms 1 make a field of rms 1 in each degree, one gap away.

    Args:
        points_m: Anywhere but at the multipoles, which are singular.
        places_m: Of the multipoles.
        gaps_m: Distance from each at which its amplitudes are given, above zero.
        amplitudes: By multipole, degree and term.
    References: Jackson, Classical Electrodynamics, 3rd ed., section 4.1.
    """
    total = torch.zeros_like(points_m)
    of_each = amplitudes.unflatten(-1, (len(places_m), sum(SIZES)))
    for i, (place_m, gap_m) in enumerate(zip(places_m, gaps_m, strict=True)):
        own = of_each[..., i, :].split(SIZES, dim=-1)
        shared = {degree: part / len(terms(degree)) ** 0.5 for degree, part in enumerate(own, start=1)}
        total = total + exterior_field((points_m - place_m) / gap_m, shared)
    return total
