"""A weak cause that the fit follows for the most part is seen by its pattern, and noise is not."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.calibration.halves import clearest_pattern
from estimator.calibration.linear_fit import LinearFit
from estimator.effects.attach import with_effect
from estimator.model.simulate import simulate
from estimator.readings.observations import Observations
from estimator.rig.rig import Cause
from tests.estimator.calibration.test_halves import PLAN, RIG, TRUTH, readings

pytestmark = pytest.mark.whole

IRON = {"volume_m3": 1e-4, "x_m": 0.15, "y_m": 0.05, "z_m": -0.05}
RACK = Cause("iron_body", "room")


def p_value(observations: Observations) -> float:
    pattern = clearest_pattern(LinearFit.of(RIG, observations, {**RIG.nominal_values(), **TRUTH}))
    assert pattern is not None
    return pattern.p_value


def test_noise_alone_has_a_pattern_as_rarely_as_is_said():
    values = np.array([p_value(readings(seed)) for seed in range(100, 120)])
    assert values.min() > 1e-3
    assert (values < 0.2).mean() <= 0.5  # adjusted for all tests: at most one in five, within its scatter
    assert values.min() < 0.5, "a test that never speaks says nothing"


def test_a_rack_beside_the_coil_that_moves_few_readings_by_their_noise_is_seen():
    rig = with_effect(RIG, RACK, readings(0), IRON, is_free=False)
    beside_iron = simulate(rig, PLAN, TRUTH, seed=1).calibration
    off = (beside_iron.field_sensor_T - readings(1).field_sensor_T).square().mean().sqrt()
    assert off < 0.7 * RIG.parameters["hall.noise_T"].value
    assert p_value(beside_iron) < 1e-4
