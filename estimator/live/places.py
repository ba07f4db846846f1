"""Positions of readings and what the estimate leaves of them, for a picture beside the rig."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.rig.rig import Rig


@dataclass(frozen=True)
class Place:
    """One reading in the frame of the coil that carried the largest current.

    Attributes:
        number: Of the reading.
        coil: Name of that coil; the first one where none carried any.
        sensor: Name of the sensor.
        position_m: Place of the sensor.
        field_T: Measured field; components that were not measured are 0.
        residual_T: Measured less predicted field, likewise.
        rms_sigma: Root mean square of the measured components of the residual, in units of the noise.
        is_fitted: Whether the estimate holds it.
    """

    number: int
    coil: str
    sensor: str
    position_m: tuple[float, float, float]
    field_T: tuple[float, float, float]
    residual_T: tuple[float, float, float]
    rms_sigma: float
    is_fitted: bool


def places(
    rig: Rig, values: Mapping[str, Tensor], readings: Observations, numbers: Sequence[int]
) -> list[Place]:
    """Places of those readings that have a measured component, in order.

    Args:
        rig: The rig.
        values: Every number of it, as `Stream.values` gives them.
        readings: The readings.
        numbers: Number of each.
    Raises:
        InvalidInput: A sensor would stand inside a winding.
    """
    model = MeasurementModel.build(rig, readings)
    with torch.no_grad():
        residual_T = readings.field_sensor_T - model.predict(values).expand(len(readings), 3)
        noise_T = torch.stack([values[f"{sensor.name}.noise_T"] for sensor in rig.sensors])[readings.sensor]
        rms_sigma = (residual_T / noise_T[:, None]).square().nanmean(-1).sqrt()
        strongest = readings.current_A.abs().argmax(-1)
        at_coils = [model.readings_in_coil(coil, values) for coil in rig.coils]
    result = []
    for row in torch.nonzero(~residual_T.isnan().all(-1))[:, 0].tolist():
        coil = int(strongest[row])
        position_m, coil_from_sensor = (part[row] for part in at_coils[coil])
        x, y, z = position_m.tolist()
        vectors_T = torch.stack([readings.field_sensor_T[row], residual_T[row]]).nan_to_num()
        (bx, by, bz), (u, v, w) = (vectors_T @ coil_from_sensor.mT).tolist()
        sensor = rig.sensors[int(readings.sensor[row])].name
        is_fitted = not bool(readings.is_validation[row])
        sigma = float(rms_sigma[row])
        name = rig.coils[coil].name
        result.append(Place(numbers[row], name, sensor, (x, y, z), (bx, by, bz), (u, v, w), sigma, is_fitted))
    return result
