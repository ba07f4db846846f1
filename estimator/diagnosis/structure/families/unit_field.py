"""Field that one coil would make at every reading with its largest current, whatever current it carried."""

from __future__ import annotations

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.diagnosis.fitting import Fit
from estimator.model.measurement_model import MeasurementModel


def unit_field_T(fit: Fit, coil: int) -> Float[Tensor, "reading 3"]:
    """Predicted reading with that current in the coil and none in the others, less the reading without any."""
    observations, model = fit.observations, fit.posterior.model
    largest_A = model.circumstances.largest_current_A
    predictions = []
    for current in (largest_A, 0.0):
        current_A = torch.zeros_like(observations.current_A)
        current_A[:, coil] = current
        there = MeasurementModel.unruled(fit.rig, replace(observations, current_A=current_A))
        with torch.no_grad():
            predicted_T = there.with_rules(model.rules).predict(fit.values)
        predictions.append(predicted_T.expand(len(observations), 3))
    return predictions[0] - predictions[1]
