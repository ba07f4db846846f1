"""Noise of every component of some readings: that of its sensor, and what effects of noise make of it."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from jaxtyping import Float

from estimator.effects.stages import NoiseEffect
from estimator.effects.use import uses_of
from estimator.inference.likelihood import LogPosterior
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.readings.scatter import scatter_T
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


def noise_rms_T(
    rig: Rig,
    observations: Observations,
    values: Mapping[str, float],
    scatter: Mapping[str, float] = MappingProxyType({}),
) -> float:
    """The rms length of an error by noise alone: no model predicts readings better than that.

    Args:
        rig: Whose sensors read them.
        observations: The readings.
        values: Every number of the rig.
        scatter: Noise of sensors, by the name of its number, in place of what the rig says of it.
    """
    variance = noise_of_readings_T(rig, observations, values).square()
    for i, sensor in enumerate(rig.sensors):
        if (noise_T := scatter.get(f"{sensor.name}.noise_T")) is not None:
            variance[observations.sensor == i] = noise_T**2
    is_measured = observations.is_measured
    return float((is_measured * variance).sum(1)[is_measured.any(1)].mean().sqrt())


def scatter_of_sensors(rig: Rig, observations: Observations) -> dict[str, float]:
    """Noise of each sensor by readings at the same places, where there are enough: no prior knows it better.

    Args:
        rig: Whose sensors read them.
        observations: The readings.
    Returns: By the name of its number in the rig.
    """
    by_sensor = scatter_T(observations, len(rig.sensors))
    return {
        f"{sensor.name}.noise_T": noise_T
        for sensor, noise_T in zip(rig.sensors, by_sensor, strict=True)
        if noise_T is not None
    }


def noise_words(are_repeated: bool) -> str:
    """What is told before the noise of readings.

    Args:
        are_repeated: Their scatter says how large it is, to which currents and movers that jitter add; else the rig file does.
    """
    return "repeated readings scatter by" if are_repeated else "the expected noise leaves"
