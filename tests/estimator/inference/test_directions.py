"""Compressed derivatives against those in every coordinate by itself."""

from __future__ import annotations

import pytest
import torch

from estimator.derivatives import jacobian_of
from estimator.effects.attach import with_effect
from estimator.inference.directions import EVERY, Directions
from estimator.inference.likelihood import LogPosterior
from estimator.model.measurement_model import MeasurementModel
from estimator.rig.coordinates import Coordinates
from estimator.rig.rig import Cause
from tests.estimator.inference.test_likelihood import COIL, TWO_SENSORS

OF_SENSORS = ("sensor_misplaced", "axis_gain", "sensor_offset", "element_displacement")


@pytest.fixture(scope="module")
def posterior(problem) -> LogPosterior:
    """Two sensors with the same causes, and a background of the room."""
    simulated = problem(COIL, TWO_SENSORS, noise_T=0.4e-6)
    rig = simulated.real.model.rig
    causes = [Cause(name, sensor.name) for name in OF_SENSORS for sensor in rig.sensors]
    for cause in [*causes, Cause("background_field", "room")]:
        rig = with_effect(rig, cause, simulated.observations, {})
    model = MeasurementModel.build(rig, simulated.observations)
    return LogPosterior(Coordinates(rig), model, simulated.observations)


def test_one_direction_for_both_sensors_gives_all_derivatives(posterior):
    coordinates = posterior.coordinates
    directions = Directions.of(posterior.model.rig, coordinates)
    n_own = int((directions.sensor == 0).sum())
    assert n_own > 15
    assert len(directions.each) == coordinates.n - n_own
    draw = torch.randn(coordinates.n, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    vector = coordinates.start() + 0.1 * coordinates.scale * draw
    expected = jacobian_of(posterior._for_jacobian.predicted, vector)
    torch.testing.assert_close(posterior.jacobian(vector), expected, rtol=1e-10, atol=1e-20)
    log_sigma = jacobian_of(lambda v: torch.log(posterior.component_sigma_T(v)), vector)
    torch.testing.assert_close(posterior.to_first_order(vector).log_sigma_jacobian, log_sigma)


def test_rig_that_may_exchange_its_sensors_shares_no_direction(posterior):
    rig = with_effect(
        posterior.model.rig,
        Cause("sensors_exchanged", "record"),
        posterior.model.circumstances.observations,
        {},
    )
    directions = Directions.of(rig, Coordinates(rig))
    assert bool((directions.sensor == EVERY).all())
    assert not directions.is_compressed
