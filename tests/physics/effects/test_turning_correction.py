"""How a sensor is turned by its rotary stage at each angle: worked out by hand with numpy from the readings without it."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from estimator.effects import EFFECTS
from estimator.effects.attach import with_effect
from estimator.effects.circumstances import Circumstances
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.rig.rig import Cause
from estimator.rig_files.read import rig_from_text

RIG = """
schema_version: 1
name: probe on a rotary stage
movers: {stage: {motion: pose}}
coils:
  coil: {radius_mm: 40, wire_radius_mm: 0.5, axial_loops: 6, radial_loops: 4, world_from_coil: {z_mm: -60}}
sensors:
  probe: {noise_uT: 5, carried_by: stage, flange_from_sensor: {x_mm: 15, ry_deg: 20}}
  beside: {noise_uT: 5, world_from_sensor: {x_mm: 5}}
"""
ANGLES_RAD = np.deg2rad(np.arange(-160.0, 181.0, 20.0))  # 18
AXIS = np.array([0.0, 0.6, 0.8])
CAUSE = Cause("turns_by_angle", "probe")
SIZES = {"degree1_x_cos": 1e-3, "degree1_z_sin": -2e-3, "degree3_y_cos": 3e-3}


def readings(turns_rad: np.ndarray) -> Observations:
    n = len(turns_rad)
    motion = np.zeros((n, 6))
    motion[:, 2], motion[:, 3:] = np.linspace(0.0, 0.03, n), turns_rad
    stage = {"stage": torch.from_numpy(motion)}
    return Observations.of(torch.ones(n, 1).double(), stage, torch.zeros(n, 3).double())


ABOUT_ONE = readings(ANGLES_RAD[:, None] * AXIS)


def predicted_T(observations: Observations, values: dict[str, float] | None) -> np.ndarray:
    rig = rig_from_text(RIG)
    if values is not None:
        rig = with_effect(rig, CAUSE, observations, values, is_free=False)
    at = {name: torch.tensor(v, dtype=torch.float64) for name, v in rig.nominal_values().items()}
    with torch.no_grad():
        return MeasurementModel.build(rig, observations).predict(at).expand(len(observations), 3).numpy()


def circumstances(observations: Observations) -> Circumstances:
    return Circumstances(rig_from_text(RIG), observations)


def test_the_sensor_is_turned_by_waves_of_the_angle_of_its_stage():
    (start,) = EFFECTS[CAUSE.name].starts(circumstances(ABOUT_ONE), "probe")
    assert [start[f"axis_{name}"] for name in "xyz"] == pytest.approx(AXIS)
    plain_T, turned_T = predicted_T(ABOUT_ONE, None), predicted_T(ABOUT_ONE, {**start, **SIZES})
    turn_rad = np.stack(
        (1e-3 * np.cos(ANGLES_RAD), 3e-3 * np.cos(3.0 * ANGLES_RAD), -2e-3 * np.sin(ANGLES_RAD)), axis=1
    )
    by_hand_T = Rotation.from_rotvec(turn_rad).inv().apply(plain_T)
    assert np.abs(by_hand_T - plain_T).max() > 1e-3 * np.abs(plain_T).max()
    # the correction is of first order in the turn
    np.testing.assert_allclose(turned_T, by_hand_T, rtol=0.0, atol=1e-5 * np.abs(plain_T).max())


def test_it_concerns_sensors_on_a_stage_that_turned_about_one_axis():
    effect = EFFECTS[CAUSE.name]
    assert effect.concerns(circumstances(ABOUT_ONE), "probe")
    assert not effect.concerns(circumstances(ABOUT_ONE), "beside")
    assert not effect.concerns(circumstances(readings(0.0 * ANGLES_RAD[:, None] * AXIS)), "probe")
    about_two = ANGLES_RAD[:, None] * np.where(np.arange(18)[:, None] % 2, AXIS, AXIS[::-1])
    assert not effect.concerns(circumstances(readings(about_two)), "probe")


def test_angles_bound_the_degree():
    limit = EFFECTS[CAUSE.name].limit(circumstances(ABOUT_ONE), "probe")  # type: ignore[attr-defined]
    assert limit.degree == 3  # two waves for each axis and degree: 18 angles, three for each wave
    assert "18 different angles" in limit.words
