"""Effects of the sensor worked out component by component on the fields of magpylib's loops."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from estimator.effects import EFFECTS
from estimator.effects.circumstances import Circumstances
from estimator.rig_files.read import rig_from_text
from tests.physics.effects.laboratory import (
    POINTS_M,
    RIG,
    assert_same_field,
    predicted_T,
    readings,
    winding,
)

CURRENT_A = 40.0  # some millitesla, so that bent responses show
TURNS = Rotation.random(len(POINTS_M), rng=np.random.default_rng(6))
READINGS = readings(POINTS_M, (CURRENT_A, 0.0), turn_rad=TURNS.as_rotvec())
X_T, Y_T, Z_T = (CURRENT_A * TURNS.inv().apply(winding().field_T(POINTS_M))).T


def of(x_T: np.ndarray, y_T: np.ndarray, z_T: np.ndarray) -> np.ndarray:
    return np.stack(np.broadcast_arrays(x_T, y_T, z_T), axis=1)


def test_sensor_without_effects_reads_the_field_in_its_axes():
    assert_same_field(predicted_T(READINGS), of(X_T, Y_T, Z_T))


def test_antisymmetric_cross_axis_is_a_sensor_turned_by_a_small_angle():
    angle = 1e-4
    turn = Rotation.from_rotvec([0.0, 0.0, angle])
    reading_T = predicted_T(READINGS, {"cross_axis[probe]": {"xy": angle, "yx": -angle}})
    assert_same_field(reading_T, turn.inv().apply(of(X_T, Y_T, Z_T)), 2.0 * angle**2)


def test_temperature_changes_gain_and_zero_in_proportion_to_kelvins_above_the_mean():
    celsius = np.array([20.0, 22.0, 25.0, np.nan, 21.0, 23.0, 21.0])
    warm = readings(POINTS_M, (CURRENT_A, 0.0), turn_rad=TURNS.as_rotvec(), temperature_C={"probe": celsius})
    given = {"gain_per_K": 2e-3, "x_T_per_K": 1e-5, "z_T_per_K": -3e-5}
    reading_T = predicted_T(warm, {"temperature_drift[probe]": given})
    kelvin = np.nan_to_num(celsius - np.nanmean(celsius))
    gain = 1.0 + 2e-3 * kelvin
    assert_same_field(reading_T, of(gain * X_T + 1e-5 * kelvin, gain * Y_T, gain * Z_T - 3e-5 * kelvin))


def test_sensor_effects_act_in_the_order_field_mixing_gain_offset_range():
    limit_T = 2e-3
    effects = {
        "range_clipping[probe]": {"limit_T": limit_T},
        "sensor_offset[probe]": {"x_T": 1e-3},
        "axis_gain[probe]": {"x": 0.5},
        "cross_axis[probe]": {"xy": 0.3},
    }
    expected = np.clip(of(1.5 * (X_T + 0.3 * Y_T) + 1e-3, Y_T, Z_T), -limit_T, limit_T)
    assert_same_field(predicted_T(READINGS, effects), expected)


def test_elements_that_move_together_are_a_sensor_that_sits_elsewhere():
    shift_m = np.array([3e-4, -5e-4, 2e-4])
    together = {f"{e}_at_{a}_m": shift_m[j] for e in "xyz" for j, a in enumerate("xyz")}
    elsewhere = readings(POINTS_M + TURNS.apply(shift_m), (CURRENT_A, 0.0), turn_rad=TURNS.as_rotvec())
    reading_T = predicted_T(READINGS, {"element_displacement[probe]": together})
    assert_same_field(reading_T, predicted_T(elsewhere), 1e-12)


@pytest.mark.parametrize(("side", "sign"), [(1.0, 1), (-1.0, -1)])
@pytest.mark.parametrize("along", [0, 2])
def test_contact_changes_gains_and_zero_on_its_side_of_the_place_only(along, side, sign):
    beyond_m = float(np.median(POINTS_M[:, along])) + 1e-3
    given = {"x": 0.02, "z": -0.01, "y_T": 3e-5, "along": along, "beyond_m": beyond_m, "side": side}
    changed = np.stack((1.02 * X_T, Y_T + 3e-5, 0.99 * Z_T), axis=1)
    expected = [
        there if sign * (point[along] - beyond_m) > 0.0 else here
        for point, there, here in zip(POINTS_M, changed, of(X_T, Y_T, Z_T), strict=True)
    ]
    assert_same_field(predicted_T(READINGS, {"sensor_contact[probe]": given}), np.array(expected))


def test_contact_begins_between_places_along_axes_along_which_the_mover_went():
    points_m = np.stack((np.repeat([0.0, 0.01, 0.02], 4), np.tile([0.0, 0.03], 6), np.full(12, 0.05)), axis=1)
    circumstances = Circumstances(rig_from_text(RIG), readings(points_m, (CURRENT_A, 0.0)))
    starts = EFFECTS["sensor_contact"].starts(circumstances, "probe")
    places = {(start["along"], round(start["beyond_m"], 6), start["side"]) for start in starts}
    expected = {(0.0, at, side) for at in (0.005, 0.015) for side in (1.0, -1.0)}
    assert places == expected | {(1.0, 0.015, side) for side in (1.0, -1.0)}


WAY_M = np.stack((np.linspace(0.0, 0.32, 33), np.full(33, 0.02), np.full(33, 0.05)), axis=1)


def of_two_probes(n_own: int) -> Circumstances:
    """Readings along one way, the first by the probe and all others by another one."""
    along = readings(WAY_M, (CURRENT_A, 0.0))
    sensor = (torch.arange(len(along)) >= n_own).long()
    rig = rig_from_text(RIG + "  second: {carried_by: mapper, noise_uT: 5}\n")
    return Circumstances(rig, replace(along, sensor=sensor))


def test_contact_begins_between_readings_of_its_own_sensor_whatever_others_read_elsewhere():
    starts = EFFECTS["sensor_contact"].starts(of_two_probes(3), "probe")
    assert {round(start["beyond_m"], 6) for start in starts} == {0.005, 0.015}
    others = EFFECTS["sensor_contact"].starts(of_two_probes(3), "second")
    assert min(start["beyond_m"] for start in others) > WAY_M[3, 0]


@pytest.mark.parametrize("name", ["sensor_contact", "response_by_place"])
def test_what_depends_on_the_place_is_not_asked_of_a_sensor_that_was_read_at_one_place(name):
    asked = [EFFECTS[name].concerns(of_two_probes(1), sensor) for sensor in ("probe", "second")]
    assert asked == [False, True]


def test_degree_of_a_response_by_place_is_limited_by_the_places_of_the_sensors_own_readings():
    limits = [EFFECTS["response_by_place"].limit(of_two_probes(3), sensor) for sensor in ("probe", "second")]
    assert limits[0].words.startswith("there are 3 different places")
    assert limits[0].degree < limits[1].degree
