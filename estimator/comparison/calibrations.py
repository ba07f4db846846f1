"""Two calibrations side by side: their numbers, and their fields at the readings and in the plane through each coil's axis."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from estimator.calibration.result import Calibration
from estimator.errors import InvalidInput
from estimator.field.winding import Winding
from estimator.model.bodies import round_winding_of
from estimator.model.measurement_model import MeasurementModel
from estimator.model.room_field import RoomField, at_one_moment, some_at_a_time
from estimator.rig.bodies import AnyCoil

PLANE_POINTS, PLANE_DRAWS = 41, 100
MOST_PLACES = 500  # of readings
REACH = 1.1  # times the farthest reading


@dataclass(frozen=True)
class NumberPair:
    """One number in two calibrations.

    Attributes:
        name: Of the parameter.
        first, second: Medians.
        first_sd, second_sd: Standard deviations.
    """

    name: str
    first: float
    first_sd: float
    second: float
    second_sd: float

    @property
    def distance_sd(self) -> float:
        """Difference over the standard deviation of independent results; 0 where both are exact and equal."""
        sd = math.hypot(self.first_sd, self.second_sd)
        difference = abs(self.second - self.first)
        return difference / sd if sd > 0.0 else (0.0 if difference == 0.0 else math.inf)


@dataclass(frozen=True)
class FieldDifference:
    """Difference of the fields of one coil at some points, for one ampere.

    Attributes:
        size_T_per_A: Length of the difference; NaN inside a winding of either.
        field_T_per_A: Length of the field of the first.
        sds: Difference over its standard deviation, by draws of both.
    """

    size_T_per_A: np.ndarray
    field_T_per_A: np.ndarray
    sds: np.ndarray

    @property
    def rms_T_per_A(self) -> float:
        """Root mean square of the difference."""
        return float(np.sqrt(np.nanmean(self.size_T_per_A**2)))

    @property
    def relative(self) -> float:
        """Rms of the difference over the rms of the field."""
        return self.rms_T_per_A / float(np.sqrt(np.nanmean(self.field_T_per_A**2)))

    @property
    def median_sds(self) -> float:
        """Median of the difference in standard deviations; about 1 where both agree."""
        return float(np.nanmedian(self.sds))


@dataclass(frozen=True)
class PlaneDifference:
    """Difference of the fields of one coil where readings were taken, and in the plane y = 0 of its frame in the first calibration.

    Attributes:
        coil: Its name.
        x_m, z_m: Coordinates of the plane.
        in_plane: By x and z.
        at_readings: At places of the sensors in the first.
        winding: Of the coil in the first.
    """

    coil: str
    x_m: np.ndarray
    z_m: np.ndarray
    in_plane: FieldDifference
    at_readings: FieldDifference
    winding: Winding | None


@dataclass(frozen=True)
class SideBySide:
    """Two calibrations of one set-up.

    Attributes:
        names: What they are called.
        calibrations: The two.
        numbers: Parameters that both have.
        only: Parameters that only one of them has, first and second.
        planes: Differences of the fields.
        is_same_session: Whether they were made from the same readings, so that they are not independent.
    """

    names: tuple[str, str]
    calibrations: tuple[Calibration, Calibration]
    numbers: tuple[NumberPair, ...]
    only: tuple[tuple[str, ...], tuple[str, ...]]
    planes: tuple[PlaneDifference, ...]
    is_same_session: bool

    def to_json(self) -> dict[str, Any]:
        """Content of `comparison.json`."""
        return {
            "calibrations": list(self.names),
            "verdicts": [verdict_of(calibration) for calibration in self.calibrations],
            "is_same_session": self.is_same_session,
            "numbers": [
                asdict(pair) | {"distance_sd": pair.distance_sd if math.isfinite(pair.distance_sd) else None}
                for pair in self.numbers
            ],
            "only_in_first": list(self.only[0]),
            "only_in_second": list(self.only[1]),
            "fields": [
                {
                    "coil": plane.coil,
                    "rms_T_per_A": plane.at_readings.rms_T_per_A,
                    "relative": plane.at_readings.relative,
                    "largest_T_per_A": float(np.nanmax(plane.at_readings.size_T_per_A)),
                    "median_sds": plane.at_readings.median_sds,
                }
                for plane in self.planes
            ],
        }


def side_by_side(first: Calibration, second: Calibration, names: tuple[str, str]) -> SideBySide:
    """Compare two calibrations.

    Args:
        first, second: Of set-ups with a coil in common, in the same world frame.
        names: What they are called, such as their folders.
    Raises:
        InvalidInput: They have no coil in common.
    """
    own, others = (dict(calibration.summary()["parameters"]) for calibration in (first, second))
    numbers = tuple(
        NumberPair(name, own[name]["median"], own[name]["sd"], others[name]["median"], others[name]["sd"])
        for name in own
        if name in others
    )
    shared = [coil for coil in first.rig.coils if coil.name in {each.name for each in second.rig.coils}]
    if not shared:
        received = " and ".join(", ".join(c.name for c in each.rig.coils) for each in (first, second))
        raise InvalidInput(f"calibrations must have a coil in common; received {received}")
    hashes = {calibration.summary()["session_hash"] for calibration in (first, second)}
    only = (tuple(n for n in own if n not in others), tuple(n for n in others if n not in own))
    planes = tuple(plane for coil in shared if (plane := _plane(first, second, coil)) is not None)
    return SideBySide(names, (first, second), numbers, only, planes, len(hashes) == 1)


def _plane(first: Calibration, second: Calibration, coil: AnyCoil) -> PlaneDifference | None:
    """The plane reaches as far as the readings of the first; None where the coil carried no current in it."""
    best, rig = first.best_values(), first.rig
    model = MeasurementModel.build(rig, first.observations)
    rows = model.powered[coil.name]
    if not len(rows):
        return None
    points, _ = model.sensor_in_coil(coil, rows, best)
    winding = round_winding_of(rig, coil, best)
    across = REACH * float(points[:, :2].abs().max())
    low, high = float(points[:, 2].min()), float(points[:, 2].max())
    if winding is not None:
        across = max(across, REACH * float(winding.radius_m))
        low, high = min(low, -REACH * float(winding.length_m)), max(high, 0.5 * float(winding.radius_m))
    x_m, z_m = np.linspace(-across, across, PLANE_POINTS), np.linspace(low, high, PLANE_POINTS)
    grid = np.stack(np.meshgrid(x_m, [0.0], z_m, indexing="ij"), axis=-1)[:, 0].transpose(1, 0, 2)
    world_from_coil = at_one_moment(rig).world_from_body(coil, "coil", torch.arange(1), best)
    at_readings_m = points[:: math.ceil(len(points) / MOST_PLACES)]
    points_m = world_from_coil.apply(torch.cat((torch.from_numpy(grid.reshape(-1, 3)), at_readings_m)))
    (of_first, sd_first), (of_second, sd_second) = (
        _per_ampere(calibration, coil.name, points_m) for calibration in (first, second)
    )
    difference = of_second - of_first
    sd = torch.hypot(sd_first, sd_second)
    sizes = (
        difference.norm(dim=1),
        of_first.norm(dim=1),
        difference.norm(dim=1) / sd.norm(dim=1).clamp(min=1e-18),
    )
    n, shape = PLANE_POINTS**2, (PLANE_POINTS, PLANE_POINTS)
    in_plane = FieldDifference(*(values[:n].reshape(shape).numpy() for values in sizes))
    at_readings = FieldDifference(*(values[n:].numpy() for values in sizes))
    return PlaneDifference(coil.name, x_m, z_m, in_plane, at_readings, winding)


def _per_ampere(
    calibration: Calibration, coil: str, points_m: Float[Tensor, "point 3"]
) -> tuple[Float[Tensor, "point 3"], Float[Tensor, "point 3"]]:
    """Field of one ampere beyond that of none, and its standard deviation."""
    room = RoomField(calibration.rig, calibration.best_values(), points_m)
    on_A, off_A = calibration.currents({coil: 1.0}), calibration.currents({})

    def field_T(values: Mapping[str, Tensor]) -> Tensor:
        return room.field_T(values, on_A) - room.field_T(values, off_A)

    drawn = some_at_a_time(field_T, calibration.draw_values(PLANE_DRAWS), len(points_m), 2)
    sd = drawn.std(dim=0) if drawn.ndim > 2 and len(drawn) > 1 else torch.zeros_like(points_m)
    return field_T(calibration.best_values()), sd


def verdict_of(calibration: Calibration) -> str | None:
    """Whether a calibration can be used; None of one that was never judged."""
    quality = calibration.summary().get("quality")
    return None if quality is None else str(quality["verdict"])
