"""Poses and widths of the coils at a reading, for a picture beside the rig."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from estimator.field.sided import SidedWinding
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
