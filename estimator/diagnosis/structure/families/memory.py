"""Memory of earlier fields, as eddy currents, magnetic viscosity and the filters of an instrument have."""

from __future__ import annotations

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit
from estimator.model.measurement_model import MeasurementModel


def lingering_T(fit: Fit, decay_steps: float) -> Float[Tensor, "reading 3"] | None:
    """Sum of all earlier changes of the field at the sensor, each decayed exponentially; None for sessions that are too long.

    In the sensor's frame E_k = (E_(k-1) + B_(k-1) - B_k) exp(-dt / tau); each sensor counts at every reading, also while others are read.

    Args:
        fit: Predicts the field over the whole session.
        decay_steps: Time constant tau over the typical time between readings.
    References: Jackson, Classical Electrodynamics, 3rd ed., section 5.18 (diffusion of fields in conductors).
    """
    history = fit.observations.history
    n_sensors = len(fit.rig.sensors)
    if len(history) * n_sensors > policy.MOST_HISTORY_PREDICTED:
        return None
    step_s = torch.diff(history.time_s, prepend=history.time_s[:1])
    typical_s = step_s[1:].median().clamp(min=1e-9) if len(history) > 1 else step_s.new_tensor(1.0)
    decay = torch.exp(-step_s / (decay_steps * typical_s))
    result = decay.new_zeros(len(fit.observations), 3)
    for sensor in range(n_sensors):
        as_sensor = replace(history, sensor=torch.full_like(history.sensor, sensor))
        model = MeasurementModel.unruled(fit.rig, as_sensor).with_rules(fit.posterior.model.rules)
        with torch.no_grad():
            field_T = model.predict(fit.values).expand(len(history), 3)
        state, states = decay.new_zeros(3), []
        for k in range(len(history)):
            state = (state + field_T[max(k - 1, 0)] - field_T[k]) * decay[k]
            states.append(state)
        at_readings = torch.stack(states)[fit.observations.row]
        result = torch.where((fit.observations.sensor == sensor)[:, None], at_readings, result)
    return result
