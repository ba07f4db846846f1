"""How far sensors stand from windings."""

from __future__ import annotations

from jaxtyping import Float, Int

from estimator.model.bodies import winding_of
from estimator.model.measurement_model import MeasurementModel
from estimator.rig.bodies import WoundCoil
from estimator.tensors import Tensor, torch


def clearance_m(model: MeasurementModel) -> Float[Tensor, " reading"]:
    """Distance of each reading's sensor from the nearest winding, at nominal values; 0 inside, infinite where no coil has one."""
    rows = model.every_row
    distances_m = [torch.full_like(model.circumstances.current_A[:1, 0], torch.inf)]
    distances_m += [_distance_m(model, coil, rows) for coil in model.rig.wound]
    nearest_m = torch.stack([each_m.expand(len(rows)) for each_m in distances_m]).amin(0)
    return nearest_m.clamp(min=0.0)[model.pose_row]


def nearest_m(model: MeasurementModel) -> dict[str, float]:
    """Distance of the nearest sensor from each winding that carries current, at nominal values; 0 inside it."""
    return {
        coil.name: float(_distance_m(model, coil, rows).min())
        for coil in model.rig.wound
        if len(rows := model.powered[coil.name])
    }


def _distance_m(model: MeasurementModel, coil: WoundCoil, rows: Int[Tensor, " row"]) -> Float[Tensor, "..."]:
    """Distance of the sensor from a winding at distinct poses; one number where both stay where they are."""
    values = model.nominal
    points_m = model.in_coil(coil, rows, values).translation_m
    return winding_of(model.rig, coil, values).distance_m(points_m)
