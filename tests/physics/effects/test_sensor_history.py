"""Effects of what was before on a sensor: filters against their differential equation, and a sensor that changes in mid-session."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp
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

CURRENT_A = 40.0
N = len(POINTS_M)
TURNS = Rotation.random(N, rng=np.random.default_rng(8))
TIME_S = np.array([0.0, 2.0, 3.0, 7.0, 8.0, 11.0, 12.0])
READINGS = readings(POINTS_M, (CURRENT_A, 0.0), turn_rad=TURNS.as_rotvec(), time_s=TIME_S)
FIELD_T = CURRENT_A * TURNS.inv().apply(winding().field_T(POINTS_M))
LAG = {"sensor_lag[probe]": {"tau_s": 1.3}}


def settled_T(shown_T: np.ndarray, field_T: np.ndarray, dwell_s: float) -> np.ndarray:
    """Integral of tau ds/dt = field - s over a dwell in a field that stands still."""
    return solve_ivp(lambda _, s: (field_T - s) / 1.3, (0.0, dwell_s), shown_T, rtol=1e-11, atol=1e-16).y[
        :, -1
    ]


def test_lag_is_a_filter_that_begins_each_dwell_with_what_was_recorded_last():
    recorded_T = FIELD_T + np.random.default_rng(1).normal(size=(N, 3)) * 1e-3
    reading_T = predicted_T(READINGS.with_field(torch.from_numpy(recorded_T)), LAG)
    expected = [FIELD_T[0]] + [
        settled_T(recorded_T[i - 1], FIELD_T[i], TIME_S[i] - TIME_S[i - 1]) for i in range(1, N)
    ]
    assert_same_field(reading_T, np.array(expected), 1e-8)


def test_lag_of_a_simulated_session_goes_on_from_reading_to_reading_in_the_order_of_time():
    order = np.array([3, 0, 6, 1, 5, 2, 4])
    blank = (
        READINGS.with_field(torch.full((N, 3), torch.nan, dtype=torch.float64))
        .rows(torch.as_tensor(order))
        .alone
    )
    shown_T = [FIELD_T[0]]
    for i in range(1, N):
        shown_T.append(settled_T(shown_T[-1], FIELD_T[i], TIME_S[i] - TIME_S[i - 1]))
    assert_same_field(predicted_T(blank, LAG), np.array(shown_T)[order], 1e-8)


def test_lag_of_a_sensor_that_was_not_read_changes_nothing():
    """Curves of the history ask for the field at every instant, as each sensor in turn would show it."""
    rig = rig_from_text(RIG + "  second: {carried_by: mapper, noise_uT: 5}\n")
    sensor = torch.full((N,), [s.name for s in rig.sensors].index("second"))
    unread = Circumstances(rig, replace(READINGS, sensor=sensor))
    field_T = torch.from_numpy(FIELD_T)
    changed_T = EFFECTS["sensor_lag"].apply(field_T, {"tau_s": torch.tensor(1.3)}, unread, "probe")
    torch.testing.assert_close(changed_T, field_T, rtol=0.0, atol=0.0)


def test_lag_of_a_component_that_was_not_recorded_leaves_the_others_as_they_are():
    recorded_T = torch.from_numpy(FIELD_T).clone()
    whole_T = predicted_T(READINGS.with_field(recorded_T), LAG)
    recorded_T[2, 1] = torch.nan
    reading_T = predicted_T(READINGS.with_field(recorded_T), LAG)
    assert reading_T[3, 1] == pytest.approx(FIELD_T[3, 1], rel=1e-9)
    assert whole_T[3, 1] != pytest.approx(FIELD_T[3, 1], rel=1e-3)
    reading_T[3, 1] = whole_T[3, 1]
    assert_same_field(reading_T, whole_T, 1e-12)


def test_lag_knows_the_reading_before_a_chosen_one():
    recorded = READINGS.with_field(torch.from_numpy(FIELD_T))
    np.testing.assert_allclose(
        predicted_T(recorded.rows(torch.tensor([5, 2])), LAG), predicted_T(recorded, LAG)[[5, 2]], rtol=1e-12
    )


def test_lag_needs_readings_one_after_another():
    effect, rig = EFFECTS["sensor_lag"], rig_from_text(RIG)
    assert effect.concerns(Circumstances(rig, READINGS), "probe")
    assert not effect.concerns(Circumstances(rig, READINGS.rows(torch.tensor([0])).alone), "probe")


@pytest.mark.parametrize("tau_share", [0.05, 0.3, 2.0])
def test_thermal_lag_follows_the_equation_of_one_thermal_mass(tau_share):
    """tau dw/dt = T(t) - w from the first temperature on, each temperature held from one reading to the next."""
    n, duration_s = 250, 5000.0
    time_s = np.linspace(0.0, duration_s, n)
    tau_s = tau_share * duration_s
    celsius = 21.0 + 3.0 * (time_s > 0.3 * duration_s) - 2.0 * (time_s > 0.6 * duration_s)

    def slope(t: float, w: np.ndarray) -> np.ndarray:
        return (celsius[min(int(t / duration_s * (n - 1)), n - 1)] - w) / tau_s

    body = solve_ivp(slope, (0.0, duration_s), celsius[:1], t_eval=time_s, max_step=duration_s / n / 2).y[0]
    observations = readings(
        np.repeat(POINTS_M[:1], n, axis=0), (CURRENT_A, 0.0), time_s=time_s, temperature_C={"probe": celsius}
    )
    given = {"gain_per_K": 2e-3, "z_T_per_K": -3e-5, "tau_h": tau_s / 3600.0}
    kelvin = body - celsius.mean()
    z_T = CURRENT_A * winding().field_T(POINTS_M[:1])[0, 2]
    expected_T = (2e-3 * z_T - 3e-5) * kelvin
    difference_T = added_T(observations, {"thermal_lag[probe]": given})[:, 2]
    one_step = 3.0 / (tau_share * n)  # kelvin; the code takes the temperature of each step at its end
    assert np.abs(difference_T - expected_T).max() < 1.5 * one_step * abs(2e-3 * z_T - 3e-5)
    assert 1.5 * one_step < 0.5 * np.ptp(kelvin)


def test_quick_thermal_lag_is_temperature_drift():
    n = 400
    time_s = 10.0 * np.arange(n)
    celsius = 21.0 + 3.0 * np.sin(time_s / 700.0)
    warm = readings(
        np.repeat(POINTS_M[:1], n, axis=0), (CURRENT_A, 0.0), time_s=time_s, temperature_C={"probe": celsius}
    )
    given = {"gain_per_K": 2e-3, "x_T_per_K": 1e-5}
    drift_T = added_T(warm, {"temperature_drift[probe]": given})
    lagged_T = added_T(warm, {"thermal_lag[probe]": {**given, "tau_h": 1e-3}})
    assert np.abs(lagged_T - drift_T).max() < 0.03 * np.abs(drift_T).max()  # a step of heating curves is 13 s


def test_exchanged_sensor_reads_by_gains_mixings_and_zero_of_its_own_from_its_instant_on():
    gain, mixing = np.array([0.01, 0.0, -0.02]), np.zeros((3, 3))
    mixing[0, 2], mixing[1, 0], mixing[2, 1] = 0.003, -0.004, 0.006
    given = {
        "x": 0.01,
        "z": -0.02,
        "xz": 0.003,
        "yx": -0.004,
        "zy": 0.006,
        "y_T": 2e-4,
        "since_h": 7.5 / 3600.0,
    }
    later_T = (1.0 + gain) * (FIELD_T + FIELD_T @ mixing.T) + np.array([0.0, 2e-4, 0.0])
    expected = np.where((TIME_S > 7.5)[:, None], later_T, FIELD_T)
    assert_same_field(predicted_T(READINGS, {"sensor_exchanged[probe]": given}), expected)


def test_a_step_of_the_zero_starts_between_readings_of_its_own_sensor():
    """The second sensor is read after the first: a step before its first reading would be an offset of all."""
    rig = rig_from_text(RIG + "  second: {carried_by: mapper, noise_uT: 5}\n")
    second = [s.name for s in rig.sensors].index("second")
    circumstances = Circumstances(
        rig, replace(READINGS, sensor=torch.where(torch.arange(N) < 4, 1 - second, second))
    )
    first_h, second_h = TIME_S[:4] / 3600.0, TIME_S[4:] / 3600.0
    for sensor, hours in (("probe", first_h), ("second", second_h)):
        instants_h = [start["since_h"] for start in EFFECTS["offset_step"].starts(circumstances, sensor)]
        assert instants_h == [t for t in circumstances.instants_h if hours.min() < t < hours.max()]
        assert instants_h


TWO_SENSORS = RIG + "  second: {carried_by: mapper, noise_uT: 5}\n"
IN_TURNS = torch.tensor([0, 1, 1, 0, 1, 0, 0])  # sensors in the order of the rig file
CROSSTALK = {"channel_crosstalk[second]": {"share": 0.04}}


def with_crosstalk_T(before_T: np.ndarray) -> np.ndarray:
    """Fields of the second sensor mixed by hand with what the first one showed just before: the second and the fifth reading."""
    expected = FIELD_T.copy()
    for i in (1, 4):
        expected[i] += 0.04 * (before_T[i - 1] - expected[i])
    return expected


def test_crosstalk_keeps_a_share_of_what_another_sensor_showed_just_before():
    recorded_T = FIELD_T + np.random.default_rng(1).normal(size=(N, 3)) * 1e-3
    both = replace(READINGS.with_field(torch.from_numpy(recorded_T)), sensor=IN_TURNS)
    assert_same_field(predicted_T(both, CROSSTALK, TWO_SENSORS), with_crosstalk_T(recorded_T))
    recorded_T[0, 1] = np.nan
    expected = with_crosstalk_T(recorded_T)
    expected[1, 1] = FIELD_T[1, 1]  # the component that was not recorded leaves nothing behind
    partly = both.with_field(torch.from_numpy(recorded_T))
    assert_same_field(predicted_T(partly, CROSSTALK, TWO_SENSORS), expected)


def test_crosstalk_of_a_simulated_session_follows_from_the_fields_in_the_order_of_time():
    order = torch.tensor([3, 0, 6, 1, 5, 2, 4])
    blank = replace(READINGS, sensor=IN_TURNS).with_field(torch.full((N, 3), torch.nan, dtype=torch.float64))
    reading_T = predicted_T(blank.rows(order).alone, CROSSTALK, TWO_SENSORS)
    assert_same_field(reading_T, with_crosstalk_T(FIELD_T)[order.numpy()])


def test_crosstalk_of_a_chosen_reading_knows_the_one_before():
    recorded_T = FIELD_T + 1e-3
    both = replace(READINGS.with_field(torch.from_numpy(recorded_T)), sensor=IN_TURNS)
    chosen = both.rows(torch.tensor([4]))
    assert_same_field(predicted_T(chosen, CROSSTALK, TWO_SENSORS), with_crosstalk_T(recorded_T)[[4]])


def test_crosstalk_needs_two_sensors_one_read_after_the_other():
    effect = EFFECTS["channel_crosstalk"]
    assert effect.places(rig_from_text(RIG)) == ()
    rig = rig_from_text(TWO_SENSORS)
    assert effect.places(rig) == ("probe", "second")
    in_turns = Circumstances(rig, replace(READINGS, sensor=IN_TURNS))
    assert all(effect.concerns(in_turns, place) for place in effect.places(rig))
    in_a_row = Circumstances(rig, replace(READINGS, sensor=IN_TURNS.sort().values))
    assert [effect.concerns(in_a_row, place) for place in effect.places(rig)] == [False, True]
