"""Covariates of a residual: where, when and how each reading was taken."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.diagnosis.fitting import Fit

SAME_ORDER = 0.999  # correlation of time and order beyond which order says nothing that time does not


@dataclass(frozen=True)
class Covariate:
    """One number per reading, in its SI unit.

    Attributes:
        name: In words.
        by_reading: Its values.
    """

    name: str
    unit: str
    by_reading: Float[Tensor, " reading"]


def covariates(fit: Fit) -> list[Covariate]:
    """Covariates that take more than one value in the fitted readings; names give the frame."""
    return [
        covariate for covariate in _all(fit) if bool((covariate.by_reading != covariate.by_reading[0]).any())
    ]


def sensor_in_coils(fit: Fit) -> dict[str, Float[Tensor, "reading 3"]]:
    """Fitted position of the sensor in the frame of each coil, for every reading, in metres."""
    model = fit.posterior.model
    return {coil.name: model.readings_in_coil(coil, fit.values)[0] for coil in model.rig.coils}


def sensor_in_room(
    fit: Fit,
) -> tuple[Float[Tensor, "reading 3"], Float[Tensor, "reading 3 3"]]:
    """Fitted position of the sensor in the room, for every reading, in metres, and the rotation sensor_from_world."""
    model = fit.posterior.model
    all_rows = model.every_row
    with torch.no_grad():
        pose = model.world_from_sensor(all_rows, fit.values)
    position_m = pose.translation_m.expand(len(all_rows), 3)[model.pose_row]
    return position_m, pose.rotation.mT.expand(len(all_rows), 3, 3)[model.pose_row]


def predicted_T(fit: Fit) -> Float[Tensor, "reading 3"]:
    """Readings predicted by the fit, in the sensor frame."""
    model = fit.posterior.model
    with torch.no_grad():
        return model.predict(fit.values).expand(len(model.circumstances), 3)


def residual_T(fit: Fit) -> Float[Tensor, "reading 3"]:
    """Measured less predicted, in the sensor frame; NaN where a component was not measured."""
    return fit.observations.field_sensor_T - predicted_T(fit)


def _all(fit: Fit) -> Iterator[Covariate]:
    circumstances = fit.circumstances
    rig, observations = fit.rig, fit.observations
    for name, position_m in sensor_in_coils(fit).items():
        yield from _axes(f"sensor in the frame of {name}", "m", position_m)
    yield from _axes("sensor in the room", "m", sensor_in_room(fit)[0])
    field_T = predicted_T(fit)
    yield Covariate("field strength", "T", field_T.norm(dim=-1))
    yield from _axes("field in the sensor frame", "T", field_T)
    for i, coil in enumerate(rig.coils):
        yield Covariate(f"current of {coil.name}", "A", circumstances.current_A[:, i])
    yield Covariate("time", "h", circumstances.hours)
    order = observations.row.to(torch.float64)
    if len(order) > 1 and float(torch.corrcoef(torch.stack((order, circumstances.hours)))[0, 1]) < SAME_ORDER:
        yield Covariate("order of the readings", "1", order)
    for mover in rig.movers:
        yield from _axes(f"last move of {mover.name}", "m", circumstances.last_move_m(mover.name))
        yield from _axes(f"direction of approach of {mover.name}", "1", circumstances.approach(mover.name))
    for place in observations.temperature_C:
        temperature_K = circumstances.temperature_K(place)
        if temperature_K is not None:
            yield Covariate(f"temperature of {place}", "K", temperature_K)
    for i, sensor in enumerate(rig.sensors):
        if len(rig.sensors) > 1:
            yield Covariate(f"reading of {sensor.name}", "1", (circumstances.sensor == i).to(torch.float64))


def _axes(name: str, unit: str, vectors: Tensor) -> Iterator[Covariate]:
    for i, axis in enumerate("xyz"):
        yield Covariate(f"{name}, {axis}", unit, vectors[:, i])
