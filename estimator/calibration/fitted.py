"""The readings of a calibration beside its model, and where the sensor stood about each coil."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import torch

from estimator.calibration.result import Calibration
from estimator.field.winding import Winding
from estimator.model.bodies import round_winding_of
from estimator.model.measurement_model import MeasurementModel
from estimator.rig.bodies import AnyCoil


class Fitted(NamedTuple):
    """The readings of a fit beside the calibrated model.

    Attributes:
        model: Of these readings.
        best: Values of the rig.
        measured_T, predicted_T: Components of each reading, NaN where they were not measured.
        sigma_T: Noise, of all or of each component.
    """

    model: MeasurementModel
    best: dict[str, torch.Tensor]
    measured_T: np.ndarray
    predicted_T: np.ndarray
    sigma_T: float | np.ndarray

    @property
    def residual_T(self) -> np.ndarray:
        """What the model misses."""
        missed_T: np.ndarray = self.measured_T - self.predicted_T
        return missed_T


def fitted(calibration: Calibration) -> Fitted:
    """The readings of a calibration beside its model."""
    observations, best = calibration.observations.calibration, calibration.best_values()
    model = MeasurementModel.build(calibration.rig, observations)
    by_sensor_T = np.array([calibration.best[f"{s.name}.noise_T"] for s in calibration.rig.sensors])
    each_T = by_sensor_T[observations.sensor.numpy()][:, None].repeat(3, axis=1)
    sigma_T = float(by_sensor_T[0]) if len(by_sensor_T) == 1 else each_T
    return Fitted(model, best, observations.field_sensor_T.numpy(), model.predict(best).numpy(), sigma_T)


def sensor_positions(
    calibration: Calibration, fit: Fitted
) -> Iterator[tuple[AnyCoil, np.ndarray, Winding | None]]:
    """Position of the sensor in the frame of each coil that carried current, reading by reading; NaN while the coil was off."""
    for coil in calibration.rig.coils:
        rows = fit.model.powered[coil.name]
        if not len(rows):
            continue
        points, _ = fit.model.sensor_in_coil(coil, rows, fit.best)
        everywhere = np.full((len(fit.model.sensor), 3), np.nan)
        everywhere[rows.numpy()] = points.numpy()
        winding = round_winding_of(calibration.rig, coil, fit.best)
        yield coil, everywhere[fit.model.pose_row.numpy()], winding
