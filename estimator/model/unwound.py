"""Field of a coil whose winding is not known: solid harmonics, or magnetic charges on a box and multipoles beside it, per ampere."""

from __future__ import annotations

from jaxtyping import Bool, Float

from estimator.field.charged_box import charged_box_field, multipole_field
from estimator.field.harmonics import exterior_field, interior_field
from estimator.rig.coordinates import Values
from estimator.rig.rig import EquivalentSourceCoil, HarmonicCoil, Region, UnwoundCoil
from estimator.tensors import Tensor, torch

# Share of the margin: 1.5 spacings off the charges, where they pass for a layer to a part in ten thousand.
CLEAR_SHARE = 0.5
ROUNDING = 1e-9  # of a multipole's distance from the box, whose nearest point is still fit for use


def unwound_field_per_ampere(
    coil: UnwoundCoil, points_coil_m: Float[Tensor, "*#batch point 3"], values: Values
) -> Float[Tensor, "*batch point 3"]:
    """Field of one ampere in the coil frame, in T/A; free of divergence and curl, and linear in the amplitudes.

    Args:
        coil: Its region and degree, or its box.
        points_coil_m: Points in the coil frame; multipoles are singular at its origin, charges where they stand.
        values: Every number of the rig by name.
    References: Jackson, Classical Electrodynamics, 3rd ed., sections 3.3 and 4.1.
    """
    names = [name for names in coil.amplitudes.values() for name in names]
    each = torch.stack(torch.broadcast_tensors(*(values[name] for name in names)), dim=-1)
    if isinstance(coil, EquivalentSourceCoil):
        charges, multipoles = each[..., : coil.n_charges], each[..., coil.n_charges :]
        field_T = charged_box_field(points_coil_m, coil.charged_half_m, coil.intervals, charges)
        if coil.multipoles_m:
            places_m = points_coil_m.new_tensor(coil.multipoles_m)
            gaps_m = points_coil_m.new_tensor(coil.multipole_gaps_m)
            field_T = field_T + multipole_field(points_coil_m, places_m, gaps_m, multipoles)
        return field_T
    sizes = [len(own) for own in coil.amplitudes.values()]
    amplitudes = dict(zip(coil.amplitudes, each.split(sizes, dim=-1), strict=True))
    field = interior_field if coil.region is Region.INTERIOR else exterior_field
    return field(points_coil_m / _radius_m(coil, values), amplitudes)


def is_among_sources(
    coil: UnwoundCoil, points_coil_m: Float[Tensor, "*#batch point 3"], values: Values
) -> Bool[Tensor, "*batch point"]:
    """Whether points lie where a coil has no model: among the sources of an exterior field, near charges or beyond them, near a multipole.

    Args:
        coil, points_coil_m, values: As in `unwound_field_per_ampere`.
    """
    if isinstance(coil, EquivalentSourceCoil):
        return is_beyond_box(coil, points_coil_m) | is_near_multipole(coil, points_coil_m)
    distance_m: Tensor = points_coil_m.norm(dim=-1)
    if coil.region is Region.INTERIOR:
        return torch.zeros_like(distance_m, dtype=torch.bool)
    is_among: Tensor = distance_m <= _radius_m(coil, values)[..., 0]
    return is_among


def is_beyond_box(
    coil: EquivalentSourceCoil, points_coil_m: Float[Tensor, "*#batch point 3"]
) -> Bool[Tensor, "*batch point"]:
    """Whether points lie near the charges of a coil or beyond them."""
    reach_m = points_coil_m.new_tensor(coil.half_m) + CLEAR_SHARE * coil.margin_m
    is_beyond: Tensor = (points_coil_m.abs() > reach_m).any(dim=-1)
    return is_beyond


def is_near_multipole(
    coil: EquivalentSourceCoil, points_coil_m: Float[Tensor, "*#batch point 3"]
) -> Bool[Tensor, "*batch point"]:
    """Whether points lie nearer to a multipole of a coil than the box of its readings does."""
    is_near = torch.zeros_like(points_coil_m[..., 0], dtype=torch.bool)
    for place_m, gap_m in zip(coil.multipoles_m, coil.multipole_gaps_m, strict=True):
        distance_m = (points_coil_m - points_coil_m.new_tensor(place_m)).norm(dim=-1)
        is_near = is_near | (distance_m < (1.0 - ROUNDING) * gap_m)
    return is_near


def _radius_m(coil: HarmonicCoil, values: Values) -> Float[Tensor, "*#batch 1 1"]:
    return values[f"{coil.name}.reference_radius_m"][..., None, None]
