"""What lingers of the fields before: eddy currents, viscous magnetisation, filters of an instrument hold on to what was."""

from __future__ import annotations

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit
from estimator.model.measurement_model import MeasurementModel


def lingering_T(fit: Fit, decay_steps: float) -> Float[Tensor, "reading 3"] | None:
    """What is left of all changes of the field at the sensor, each dying away exponentially; None for sessions too long.

    In the sensor's frame E_k = (E_(k-1) + B_(k-1) - B_k) exp(-dt / tau), for each sensor at its own place also while others are read.

    Args:
        fit: Predicts the field over the whole session.
        decay_steps: Time constant over the typical time between readings.
    References: Jackson, Classical Electrodynamics, 3rd ed., section 5.18 (diffusion of fields in conductors).
    """
    history = fit.observations.history
    n_sensors = len(fit.rig.sensors)
    if len(history) * n_sensors > policy.MOST_HISTORY_PREDICTED:
        return None
    step_s = torch.diff(history.time_s, prepend=history.time_s[:1])
    typical_s = step_s[1:].median().clamp(min=1e-9) if len(history) > 1 else torch.tensor(1.0)
    keep = torch.exp(-step_s / (decay_steps * typical_s))
    result = torch.zeros(len(fit.observations), 3, dtype=torch.float64)
    for which in range(n_sensors):
        everywhere = replace(history, sensor=torch.full_like(history.sensor, which))
        model = MeasurementModel.unruled(fit.rig, everywhere).with_rules(fit.posterior.model.rules)
        with torch.no_grad():
            field_T = model.predict(fit.values).expand(len(history), 3)
        state, states = torch.zeros(3, dtype=torch.float64), []
        for k in range(len(history)):
            state = (state + field_T[max(k - 1, 0)] - field_T[k]) * keep[k]
            states.append(state)
        own = torch.stack(states)[fit.observations.row]
        result = torch.where((fit.observations.sensor == which)[:, None], own, result)
    return result
