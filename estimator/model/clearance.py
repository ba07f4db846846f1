"""How far sensors stand from windings, and where none may stand: inside a winding, or where a coil without one has no field."""

from __future__ import annotations

from typing import TYPE_CHECKING

from jaxtyping import Bool, Float, Int

from estimator.errors import InvalidInput
from estimator.field.coil import AnyWinding, distance_to_coil
from estimator.model.bodies import winding_of
from estimator.model.unwound import CLEAR_SHARE, is_among_sources, is_beyond_box, is_near_multipole
from estimator.rig.coordinates import Values
from estimator.rig.rig import EquivalentSourceCoil, Region, UnwoundCoil, WoundCoil
from estimator.tensors import Tensor, torch

if TYPE_CHECKING:
    from estimator.model.measurement_model import MeasurementModel

MOST_RADII = 3.0  # farther out a term of degree 8 is beyond 2000 times its amplitude, whose prior then says nothing: likely another unit


def clearance_m(model: MeasurementModel, values: Values | None = None) -> Float[Tensor, "*batch reading"]:
    """Distance of each reading's sensor from the nearest winding; 0 inside, infinite where no coil has one.

    Args:
        model: Of the readings.
        values: Of the rig's numbers; the nominal ones by default.
    """
    rows = model.every_row
    nearest_m = torch.full_like(model.circumstances.current_A[:1, 0], torch.inf).expand(len(rows))
    for coil in model.rig.wound:
        nearest_m = torch.minimum(nearest_m, _distance_m(model, coil, rows, values))
    return nearest_m.clamp(min=0.0)[..., model.pose_row]


def nearest_m(model: MeasurementModel) -> dict[str, float]:
    """Distance of the nearest sensor from each winding that carries current, at nominal values; 0 inside it."""
    return {
        coil.name: float(_distance_m(model, coil, rows).min())
        for coil in model.rig.wound
        if len(rows := model.powered[coil.name])
    }


def _distance_m(
    model: MeasurementModel, coil: WoundCoil, rows: Int[Tensor, " row"], values: Values | None = None
) -> Float[Tensor, "..."]:
    """Distance of the sensor from a winding at distinct poses; one number where both stay where they are."""
    values = values or model.nominal
    points_m = model.in_coil(coil, rows, values).translation_m
    return distance_to_coil(points_m, winding_of(model.rig, coil, values))


def refuse_inside(
    model: MeasurementModel,
    coil: WoundCoil,
    rows: Int[Tensor, " row"],
    points_m: Float[Tensor, "... 3"],
    winding: AnyWinding,
) -> None:
    """Refuse sensors inside a winding.

    Args:
        model: Of the readings.
        coil: Whose winding it is.
        rows: Distinct poses at which the coil has a field.
        points_m: The sensor there, in the frame of the coil.
        winding: Of the coil.

    Raises:
        InvalidInput: A sensor stands there.
    """
    inside = distance_to_coil(points_m, winding) <= 0.0
    _refuse(model, f"outside the winding of {coil.name}", rows, inside)


def refuse_outside(
    model: MeasurementModel,
    coil: UnwoundCoil,
    rows: Int[Tensor, " row"],
    points_m: Float[Tensor, "... 3"],
    values: Values,
) -> None:
    """Refuse sensors where the field of a coil without a winding has no meaning: among its sources, or far beyond the sphere of reference.

    Args:
        model, coil, rows, points_m: As in `refuse_inside`.
        values: Of the rig's numbers.

    Raises:
        InvalidInput: A sensor stands there.
    """
    if isinstance(coil, EquivalentSourceCoil):
        half = " x ".join(f"{2e3 * half_m:.6g}" for half_m in coil.half_m)
        beyond = f"no more than {CLEAR_SHARE:g} of the margin, {coil.margin_m * 1e3:.6g} mm, beyond"
        _refuse(model, f"{beyond} the box of {coil.name}, {half} mm", rows, is_beyond_box(coil, points_m))
        near = is_near_multipole(coil, points_m)
        _refuse(model, f"no nearer to a multipole of {coil.name} than its box does", rows, near)
        return
    among = is_among_sources(coil, points_m, values)
    radius_m = values[f"{coil.name}.reference_radius_m"]
    where = f"of {coil.name}, {float(radius_m) * 1e3:.6g} mm"
    _refuse(model, f"outside the reference_radius {where}, which holds all its sources", rows, among)
    if coil.region is Region.INTERIOR:
        is_far = points_m.norm(dim=-1) > MOST_RADII * radius_m
        _refuse(model, f"within {MOST_RADII:g} times the reference_radius {where}", rows, is_far)


def _refuse(
    model: MeasurementModel, rule: str, rows: Int[Tensor, " row"], is_refused: Bool[Tensor, "..."]
) -> None:
    refused = is_refused.nonzero().flatten()
    if len(refused):
        reading = int(torch.isin(model.pose_row, rows[refused]).nonzero().flatten()[0])
        raise InvalidInput(
            f"sensors must lie {rule}; at the rig's nominal values {len(refused)} of "
            f"{len(rows)} poses do not, the first at reading {reading} (rig {model.rig.name!r})"
        )
