"""Poses and widths of the coils at a reading, for a picture beside the rig."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from estimator.field.sided import SidedWinding
from estimator.inference.noise_of_readings import noise_of_readings_T
from estimator.model.bodies import winding_of
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.rig.bodies import AnyCoil, UnwoundCoil
from estimator.rig.rig import Rig

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class CoilOutline:
    """The mean turn of a coil, in the middle of its winding: a circle, or a rectangle whose corners are arcs.

    Attributes:
        name: Name of the coil.
        origin_m: Origin of its frame in the world, in the middle of its front face.
        x_axis, y_axis: Its axes in the world, across the winding.
        depth_m: Of the mean turn behind the front face.
        radius_m: Mean radius, or that of the corners; 0 where the winding is not known.
        straight_m: Lengths of the straight sides along x and y; 0 for a circle.
    """

    name: str
    origin_m: Vector
    x_axis: Vector
    y_axis: Vector
    depth_m: float
    radius_m: float
    straight_m: tuple[float, float]


def outlines(rig: Rig, values: Mapping[str, Tensor], readings: Observations) -> list[CoilOutline]:
    """Every coil of a rig as it stands at the last of some readings.

    Args:
        rig: The rig.
        values: Every number of it, as `Stream.values` gives them.
        readings: The readings.
    """
    model = MeasurementModel.unruled(rig, readings)
    last = model.pose_row[-1:]
    result = []
    with torch.no_grad():
        for coil in rig.coils:
            world_from_coil = model.sources.world_from_body(coil, "coil", last, values)
            (x, y, z), rotation = world_from_coil.translation_m[0].tolist(), world_from_coil.rotation[0]
            (ax, ay, az), (bx, by, bz), _ = rotation.mT.tolist()
            sizes = _mean_turn(rig, coil, values)
            result.append(CoilOutline(coil.name, (x, y, z), (ax, ay, az), (bx, by, bz), *sizes))
    return result


def _mean_turn(
    rig: Rig, coil: AnyCoil, values: Mapping[str, Tensor]
) -> tuple[float, float, tuple[float, float]]:
    """Depth behind the front face, radius, and straight lengths along x and y."""
    if isinstance(coil, UnwoundCoil):
        return 0.0, 0.0, (0.0, 0.0)
    winding = winding_of(rig, coil, values)
    depth_m = 0.5 * float(winding.length_m)
    if not isinstance(winding, SidedWinding):
        return depth_m, float(winding.mean_radius_m), (0.0, 0.0)
    thickness_m = float(winding.thickness_m)
    radius_m = float(winding.corner_radius_m) + 0.5 * thickness_m if winding.is_rounded else 0.0
    x_m, y_m = (
        float(side_m) + thickness_m - 2.0 * radius_m for side_m in (winding.side_x_m, winding.side_y_m)
    )
    return depth_m, radius_m, (x_m, y_m)


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
        noise_T = noise_of_readings_T(rig, readings, values)
        rms_sigma = (residual_T / noise_T).square().nanmean(-1).sqrt()
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
