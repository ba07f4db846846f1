"""How far sensors stand from windings."""

from __future__ import annotations

from jaxtyping import Float, Int

from estimator.model.bodies import winding_of
from estimator.model.measurement_model import MeasurementModel
from estimator.rig.bodies import WoundCoil
from estimator.rig.coordinates import Values
from estimator.tensors import Tensor, torch


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
    return winding_of(model.rig, coil, values).distance_m(points_m)
