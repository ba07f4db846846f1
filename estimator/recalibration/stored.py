"""How well calibrations predict readings as they are stored: by their draws, not by a fit that led to them."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.calibration.result import Calibration
from estimator.inference.likelihood import LogPosterior
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.recalibration import policy
from estimator.rig.coordinates import Coordinates


def stored_log_density(calibration: Calibration, unseen: Observations) -> Float[Tensor, " reading"]:
    """Log predictive density of readings, reading by reading: the mean over draws of the posterior.

    Args:
        calibration: Made from other readings.
        unseen: Of the same rig, whatever effects the calibration has in addition.
    References: Vehtari, Gelman and Gabry, Statistics and Computing 27, 1413 (2017), eq 3.
    """
    coordinates = Coordinates(calibration.rig, integer_counts=True)
    values = calibration.draw_values(policy.N_DRAWS)
    vectors = coordinates.vector({name: values[name] for name in coordinates.names})
    model = MeasurementModel.unruled(calibration.rig, unseen).choose_rules(calibration.best_values())
    posterior = LogPosterior(coordinates, model, unseen)
    with torch.no_grad():
        by_component = posterior.component_log_density(vectors)
    reading = torch.arange(len(unseen))[:, None].expand(-1, 3)[unseen.is_measured]
    by_reading = by_component.new_zeros(len(vectors), len(unseen)).index_add(1, reading, by_component)
    return torch.logsumexp(by_reading, 0) - math.log(len(vectors))
