"""The readings of a calibration beside its model, and where the sensor stood about each coil."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import torch

from estimator.calibration.result import Calibration
from estimator.field.winding import Winding
from estimator.inference.noise_of_readings import noise_of_readings_T
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
        return self.measured_T - self.predicted_T


def fitted(calibration: Calibration) -> Fitted:
    """The readings of a calibration beside its model."""
    observations, best = calibration.observations.calibration, calibration.best_values()
    model = MeasurementModel.for_values(calibration.rig, observations, best)
    each_T = noise_of_readings_T(calibration.rig, observations, calibration.best).numpy()
    is_one = len(calibration.rig.sensors) == 1 and bool((each_T == each_T[:1, :1]).all())
    sigma_T = float(each_T[0, 0]) if is_one else each_T
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
