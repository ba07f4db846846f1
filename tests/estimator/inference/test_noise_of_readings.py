"""What noise leaves of readings: that of their own sensors, as repeated readings tell it, else as the rig file does."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from estimator.inference.noise_of_readings import noise_rms_T, scatter_of_sensors
from estimator.readings.observations import Observations
from tests.estimator.inference.conftest import make_problem


def test_noise_is_that_of_the_sensors_that_read():
    """`loud` is read often at one place and has five times the noise of the rig file; the judged readings are of `quiet`, but for one."""
    sensors = "{quiet: {carried_by: stage, noise_uT: 1}, loud: {carried_by: stage, noise_uT: 1}}"
    problem = make_problem(
        "{coil1: {radius_mm: 50, wire_radius_mm: 1, axial_loops: 1, radial_loops: 1}}", sensors
    )
    rig, n = problem.rig, 200
    fitted = readings(np.ones(n, int), 5e-6 * np.random.default_rng(1).normal(size=(n, 3)))
    scatter = scatter_of_sensors(rig, fitted)
    assert list(scatter) == ["loud.noise_T"]
    assert scatter["loud.noise_T"] == pytest.approx(5e-6, rel=0.1)
    judged = readings(np.array([0] * 9 + [1]), np.zeros((10, 3)))
    expected_T = np.sqrt(3.0 * (0.9 * 1e-12 + 0.1 * scatter["loud.noise_T"] ** 2))
    assert noise_rms_T(rig, judged, rig.nominal_values(), scatter) == pytest.approx(expected_T)
    assert noise_rms_T(rig, judged, rig.nominal_values()) == pytest.approx(np.sqrt(3.0) * 1e-6)


def readings(sensor: np.ndarray, field_T: np.ndarray) -> Observations:
    """All at one place, without current."""
    zeros = torch.zeros(len(sensor), 1, dtype=torch.float64)
    pose = {"stage": zeros.expand(-1, 6)}
    return Observations.of(zeros, pose, torch.from_numpy(field_T), sensor=torch.from_numpy(sensor))
