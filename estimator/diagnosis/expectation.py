"""What a fit leads to expect of readings, and by how much they miss it, in the size of the errors of most of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit, resolution_T
from estimator.effects.use import as_meant
from estimator.readings.observations import Observations

SD_OF_MEDIAN = 1.4826  # standard deviation over median size, of normal errors


@dataclass(frozen=True)
class Expectation:
    """What is expected of some readings.

    Attributes:
        observations: The readings.
        predicted_T: Each of them as predicted, in the frame of its sensor.
    """

    observations: Observations
    predicted_T: Float[Tensor, "reading 3"]

    @cached_property
    def size_T(self) -> Float[Tensor, " reading"]:
        """Standard deviation of the errors of most readings: of each sensor, and where fields are large a share of them."""
        errors_T = (self.observations.field_sensor_T - self.predicted_T).abs()
        field_T = self.predicted_T.norm(dim=1)
        size_T = torch.zeros_like(field_T)
        digit_T = resolution_T(self.observations.field_sensor_T[self.observations.is_measured])
        for sensor in self.observations.sensor.unique():
            own = self.observations.sensor == sensor
            typical_T = SD_OF_MEDIAN * errors_T[own].nanmedian()
            shows = own & (
                field_T > typical_T
            )  # weaker fields, as without a current, have any share of an error
            share = SD_OF_MEDIAN * (errors_T[shows] / field_T[shows, None]).nanmedian().nan_to_num(0.0)
            size_T[own] = torch.maximum(typical_T, share * field_T[own]).clamp(min=digit_T)
        return size_T

    @cached_property
    def range_T(self) -> Float[Tensor, " reading"]:
        """Twice the largest component that the sensor of each reading read."""
        field_T, range_T = self.observations.field_sensor_T.nan_to_num(0.0), torch.zeros_like(self.size_T)
        for sensor in self.observations.sensor.unique():
            own = self.observations.sensor == sensor
            range_T[own] = 2.0 * field_T[own].abs().max()
        return range_T

    @cached_property
    def misses(self) -> Float[Tensor, " reading"]:
        """How far each reading is from what is expected of it, as `distance` has it."""
        return distance(self.observations.field_sensor_T, self.predicted_T, self.size_T)

    @cached_property
    def is_far(self) -> Bool[Tensor, " reading"]:
        """Readings that are farther off than errors that are alike ever are."""
        return self.misses > policy.FAR_FROM_EXPECTED


def distance(
    first_T: Float[Tensor, "reading 3"],
    second_T: Float[Tensor, "reading 3"],
    size_T: Float[Tensor, " reading"],
) -> Float[Tensor, " reading"]:
    """Largest difference of each reading's components, in standard deviations of its errors; 0 where one of them has no value."""
    return ((first_T - second_T).abs() / size_T[:, None]).nan_to_num(0.0).amax(dim=1)


def predict_T(
    fit: Fit, values: Mapping[str, Tensor], observations: Observations
) -> Float[Tensor, "reading 3"]:
    """What the rig of a fit predicts for readings, in the frames of their sensors."""
    with torch.no_grad():
        return fit.model_of(as_meant(fit.rig, observations)).predict(values).expand(len(observations), 3)
