"""What a calibration that was handed out says of readings, asked as a user asks: by the field at the place of the sensor.

Only files are read. What a fit knew beside, such as the time of a reading or the currents before it, is in no prediction.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from estimator import Calibration, load_rig
from estimator.effects.stages import ElementEffect, HolderEffect, NoiseEffect
from estimator.effects.use import as_meant, uses_of
from estimator.model.measurement_model import MeasurementModel
from estimator.model.room_field import RoomField
from estimator.readings.metrics import error_metrics
from estimator.readings.observations import Observations
from estimator.rig.coordinates import Values
from estimator.rig.rig import Rig

DRAWS = 200
REPEATS = 20  # of the noise beside each draw


@dataclass(frozen=True)
class Errors:
    """Errors of predicted readings: rms length, rms of a component, largest length, share of the rms field, number of components."""

    vector_T: float
    component_T: float
    max_T: float
    relative: float
    n_components: int


@dataclass(frozen=True)
class HandedOut:
    """A model as a user has it.

    Attributes:
        rig: With its effects.
        values: Best values of every number.
        calibration: Draws too; None where only a rig file is there.
    """

    rig: Rig
    values: Values
    calibration: Calibration | None = None

    @classmethod
    def of_folder(cls, folder: Path) -> HandedOut:
        """A calibration on the disk."""
        calibration = Calibration.load(folder)
        return cls(calibration.rig, calibration.best_values(), calibration)

    @classmethod
    def of_rig_file(cls, path: Path) -> HandedOut:
        """A rig file, with the values that stand in it."""
        rig = load_rig(path)
        return cls(rig, {n: torch.tensor(v, dtype=torch.float64) for n, v in rig.nominal_values().items()})

    def readings_T(self, observations: Observations, values: Values | None = None) -> Tensor:
        """What the sensors should show, reading by axis, with the draws first where the values have a batch."""
        values = self.values if values is None else values
        rig = self.rig
        for correction in rig.corrections:  # those of readings are no part of a field
            rig = rig.without_cause(correction)
        own = {name: value for name, value in self.values.items() if name in rig.parameters}
        model = MeasurementModel.unruled(rig, as_meant(rig, observations))
        with torch.no_grad():
            poses = model.world_from_sensor(model.every_row, own)
            turn = poses.rotation.expand(len(model.every_row), 3, 3)[model.pose_row]
            places_m = poses.translation_m.expand(len(model.every_row), 3)[model.pose_row]
            room = RoomField(self.rig, self.values, places_m, dict(observations.motion))
            field_T = room.field_by_point_T(values, observations.current_A)
            at_sensor_T = torch.einsum("nij,...ni->...nj", turn, field_T)
            shown = {name: value for name, value in values.items() if name in rig.parameters}
            return model.shown_T(shown, at_sensor_T)

    def errors(self, observations: Observations) -> Errors:
        """Errors of the best values on readings; inside a winding, where `predict` has no value, by the measurement model."""
        measured, predicted_T = observations.field_sensor_T.numpy(), self.readings_T(observations)
        if predicted_T.isnan().any():
            model = MeasurementModel.for_values(self.rig, as_meant(self.rig, observations), self.values)
            predicted_T = torch.where(predicted_T.isnan(), model.predict(self.values), predicted_T)
        metrics = error_metrics(measured, predicted_T.numpy())
        n = int(np.isfinite(measured).sum())
        return Errors(metrics.vector_T, metrics.component_T, metrics.max_T, metrics.relative, n)

    @property
    def is_plain_to_readings(self) -> bool:
        """Whether sensors only turn, scale and shift the field at their origin, and scatter as their noise says."""
        return not any(uses_of(self.rig, stage) for stage in (ElementEffect, HolderEffect, NoiseEffect))

    def coverage90(self, observations: Observations) -> float | None:
        """Share of measured components inside the central 90 % of draws with noise; None where there are no draws."""
        if self.calibration is None or not self.is_plain_to_readings:
            return None
        draws = self.calibration.draw_values(DRAWS)
        n = min(DRAWS, self.calibration.log_prob.size)
        predicted = self.readings_T(observations, draws).expand(n, len(observations), 3).numpy()
        noise = np.stack([draws[f"{s.name}.noise_T"].expand(n).numpy() for s in self.rig.sensors], axis=-1)
        sigma = noise[:, observations.sensor.numpy(), None]
        random = np.random.default_rng(0)
        scattered = [predicted + sigma * random.standard_normal(predicted.shape) for _ in range(REPEATS)]
        low, high = np.quantile(np.concatenate(scattered), [0.05, 0.95], axis=0)
        measured = observations.field_sensor_T.numpy()
        is_measured = np.isfinite(measured)
        return float(((measured >= low) & (measured <= high))[is_measured].mean())

    @cached_property
    def flat_draws(self) -> dict[str, np.ndarray]:
        """Draws of every free number, in one row each; none where there are no draws."""
        if self.calibration is None:
            return {}
        return {name: np.ravel(draws) for name, draws in self.calibration.draws.items()}
