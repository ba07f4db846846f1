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
    added_T,
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


def test_axis_gain_multiplies_each_component():
    reading_T = predicted_T(READINGS, {"axis_gain[probe]": {"x": 0.01, "z": -0.02}})
    assert_same_field(reading_T, of(1.01 * X_T, Y_T, 0.98 * Z_T))


@pytest.mark.parametrize(
    ("key", "expected"),
    [
        ("xy", of(X_T + 0.01 * Y_T, Y_T, Z_T)),
        ("xz", of(X_T + 0.01 * Z_T, Y_T, Z_T)),
        ("yx", of(X_T, Y_T + 0.01 * X_T, Z_T)),
        ("yz", of(X_T, Y_T + 0.01 * Z_T, Z_T)),
        ("zx", of(X_T, Y_T, Z_T + 0.01 * X_T)),
        ("zy", of(X_T, Y_T, Z_T + 0.01 * Y_T)),
    ],
)
def test_cross_axis_gives_the_first_axis_a_share_of_the_second_component(key, expected):
    assert_same_field(predicted_T(READINGS, {"cross_axis[probe]": {key: 0.01}}), expected)


def test_antisymmetric_cross_axis_is_a_sensor_turned_by_a_small_angle():
    angle = 1e-4
    turn = Rotation.from_rotvec([0.0, 0.0, angle])
    reading_T = predicted_T(READINGS, {"cross_axis[probe]": {"xy": angle, "yx": -angle}})
    assert_same_field(reading_T, turn.inv().apply(of(X_T, Y_T, Z_T)), 2.0 * angle**2)


def test_sensor_offset_is_there_without_current():
    difference_T = added_T(
        readings(POINTS_M, (0.0, 0.0)), {"sensor_offset[probe]": {"x_T": 3e-5, "z_T": -1e-5}}
    )
    np.testing.assert_array_equal(difference_T, np.broadcast_to([3e-5, 0.0, -1e-5], difference_T.shape))


def test_offset_drifts_in_the_sensors_axes_with_the_hours():
    time_s = 1e9 + 1800.0 * np.arange(len(POINTS_M))
    drifting = readings(POINTS_M, (CURRENT_A, 0.0), turn_rad=TURNS.as_rotvec(), time_s=time_s)
    reading_T = predicted_T(drifting, {"offset_drift[probe]": {"y_T_per_h": 1e-4}})
    assert_same_field(reading_T, of(X_T, Y_T + 1e-4 * 0.5 * np.arange(len(POINTS_M)), Z_T))


def test_cubic_response_adds_the_cube_of_each_component():
    bend_per_T2 = np.array([50.0, -80.0, 20.0])
    given = dict(zip(("x_per_T2", "y_per_T2", "z_per_T2"), bend_per_T2, strict=True))
    reading_T = predicted_T(READINGS, {"cubic_response[probe]": given})
    assert_same_field(reading_T, of(X_T + 50.0 * X_T**3, Y_T - 80.0 * Y_T**3, Z_T + 20.0 * Z_T**3))


def test_planar_hall_adds_the_product_of_the_two_other_components():
    reading_T = predicted_T(
        READINGS, {"planar_hall[probe]": {"x_per_T": 0.5, "y_per_T": -0.2, "z_per_T": 0.7}}
    )
    assert_same_field(reading_T, of(X_T + 0.5 * Y_T * Z_T, Y_T - 0.2 * Z_T * X_T, Z_T + 0.7 * X_T * Y_T))


def test_range_clipping_cuts_each_component_off_on_both_sides():
    limit_T = float(np.quantile(np.abs([X_T, Y_T, Z_T]), 0.7))
    reading_T = predicted_T(READINGS, {"range_clipping[probe]": {"limit_T": limit_T}})
    expected = np.clip(of(X_T, Y_T, Z_T), -limit_T, limit_T)
    np.testing.assert_allclose(reading_T, expected, rtol=1e-9)
    assert (expected == limit_T).any()
    assert (expected == -limit_T).any()


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


ELEMENTS_M = np.array([[3e-4, -5e-4, 2e-4], [0.0, 6e-4, -1e-4], [-4e-4, 0.0, 7e-4]])  # element, axis
ELEMENTS = {f"{e}_at_{a}_m": ELEMENTS_M[i, j] for i, e in enumerate("xyz") for j, a in enumerate("xyz")}


def test_displaced_elements_read_the_field_where_they_sit():
    expected = np.stack(
        [
            CURRENT_A * TURNS.inv().apply(winding().field_T(POINTS_M + TURNS.apply(at_m)))[:, i]
            for i, at_m in enumerate(ELEMENTS_M)
        ],
        axis=1,
    )
    assert_same_field(predicted_T(READINGS, {"element_displacement[probe]": ELEMENTS}), expected)


def test_displaced_elements_read_what_the_gradient_says_to_first_order():
    """B_i(r + d_i) = B_i(r) + d_i . grad B_i, by differences of magpylib's field along the sensor's axes."""
    step_m, small = 1e-5, 1e-2
    gradient = np.empty((len(POINTS_M), 3, 3))  # point, component, axis
    for axis in range(3):
        shift_m = step_m * TURNS.apply(np.eye(3)[axis])
        ends = [TURNS.inv().apply(winding().field_T(POINTS_M + s * shift_m)) for s in (1.0, -1.0)]
        gradient[:, :, axis] = CURRENT_A * (ends[0] - ends[1]) / (2.0 * step_m)
    expected = np.einsum("pij,ij->pi", gradient, small * ELEMENTS_M)
    given = {key: small * value for key, value in ELEMENTS.items()}
    assert_same_field(added_T(READINGS, {"element_displacement[probe]": given}), expected, 2e-3)


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
