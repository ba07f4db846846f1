"""Noise of every component of some readings: that of its sensor, and what effects of noise make of it."""

from __future__ import annotations

from collections.abc import Mapping

from jaxtyping import Float

from estimator.effects.stages import NoiseEffect
from estimator.effects.use import uses_of
from estimator.inference.likelihood import LogPosterior
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.rig.coordinates import Coordinates
from estimator.rig.rig import Rig
from estimator.tensors import Tensor, torch


def noise_of_readings_T(
    rig: Rig, observations: Observations, values: Mapping[str, float | Tensor]
) -> Float[Tensor, "reading 3"]:
    """Standard deviation of every component; that of its sensor where the component was not measured.

    Args:
        rig: Whose sensors read them.
        observations: The readings.
        values: Every number of the rig.
    """
    known = {name: torch.as_tensor(value, dtype=torch.float64) for name, value in values.items()}
    by_sensor_T = torch.stack([known[f"{sensor.name}.noise_T"] for sensor in rig.sensors])
    sigma_T = by_sensor_T[observations.sensor][:, None].repeat(1, 3)
    if uses_of(rig, NoiseEffect) and len(observations):
        model = MeasurementModel.build(rig, observations)
        posterior = LogPosterior(Coordinates(rig), model, observations)
        sigma_T[observations.is_measured] = posterior.component_sigma_at_T(known, torch.Size())
    return sigma_T
