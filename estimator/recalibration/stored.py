"""Log predictive density of stored calibrations: from their posterior draws, not from the fit before sampling."""

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
    """Log predictive density of each reading: the logarithm of the mean density over posterior draws.

    Args:
        calibration: Calibration from other readings.
        unseen: Readings of the same rig; the calibration may have additional effects.
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
