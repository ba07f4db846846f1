"""Requests beyond the limits are refused, and no others."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import DeviceFault, Refused
from drivers.protocols import FlangePose
from drivers.safety import ArmLimits, CoilLoad, CurrentLimits, check_current, check_motion, check_temperature

LIMITS = CurrentLimits(
    -5.0, 5.0, 10.0, continuous_A=3.0, thermal_time_constant_s=100.0, highest_temperature_K=350.0
)
COLD = CoilLoad(0.0, 0.0)
BOX = ArmLimits((-0.1, -0.1, 0.0), (0.1, 0.1, 0.3), highest_speed_m_per_s=0.1)
HERE = FlangePose((0.0, 0.0, 0.1), (0.0, 0.0, 0.0))


@pytest.mark.parametrize("current_A", [5.001, -5.001, math.inf, math.nan])
def test_currents_beyond_the_limits_are_refused(current_A):
    with pytest.raises(Refused, match=r"within -5 and 5; received"):
        check_current(current_A, 0.0, COLD, LIMITS)


@pytest.mark.parametrize("current_A", [5.0, -5.0, 0.0])
def test_currents_at_the_limits_are_allowed(current_A):
    check_current(current_A, 1.0, COLD, LIMITS)


def test_a_warm_coil_is_refused_what_a_cold_one_may_carry():
    warm = COLD.after(4.0, 80.0, LIMITS)
    check_current(5.0, 40.0, COLD, LIMITS)
    with pytest.raises(Refused, match="must leave time to cool"):
        check_current(5.0, 40.0, warm, LIMITS)
    check_current(3.0, 1e9, warm, LIMITS)
    check_current(5.0, 40.0, warm.after(0.0, 1000.0, LIMITS), LIMITS)


@given(st.floats(3.01, 5.0), st.floats(0.0, 8.9))
def test_the_time_left_ends_exactly_at_the_limit(current_A, mean_square_A2):
    load = CoilLoad(0.0, mean_square_A2)
    left_s = load.time_left_s(current_A, LIMITS)
    assert load.after(current_A, left_s, LIMITS).mean_square_A2 == pytest.approx(LIMITS.continuous_A**2)


@given(st.floats(0, 5), st.floats(0, 300), st.floats(0, 300))
def test_the_load_does_not_depend_on_how_often_it_is_computed(current_A, first_s, then_s):
    load = CoilLoad(0.0, 4.0)
    twice = load.after(current_A, first_s, LIMITS).after(current_A, first_s + then_s, LIMITS)
    assert twice.mean_square_A2 == pytest.approx(
        load.after(current_A, first_s + then_s, LIMITS).mean_square_A2
    )


@pytest.mark.parametrize(
    ("temperature_K", "message"), [(350.1, "at most 76.85; it is 76.95"), (math.nan, "gives a number")]
)
def test_a_hot_coil_or_a_thermometer_without_a_number_is_a_fault(temperature_K, message):
    check_temperature(350.0, LIMITS)
    with pytest.raises(DeviceFault, match=message):
        check_temperature(temperature_K, LIMITS)


@pytest.mark.parametrize(
    ("position_m", "speed_m_per_s", "message"),
    [
        ((0.11, 0.0, 0.1), 0.05, r"arm.target.x_m must be within -0.1 and 0.1; received 0.11"),
        ((0.0, math.nan, 0.1), 0.05, r"arm.target.y_m"),
        ((0.0, 0.0, 0.1), 0.11, r"arm.speed_m_per_s must be > 0 and at most 0.1"),
        ((0.0, 0.0, 0.1), 0.0, r"arm.speed_m_per_s"),
        ((0.0, 0.0, 0.1), math.nan, r"arm.speed_m_per_s"),
    ],
)
def test_motions_beyond_the_limits_are_refused(position_m, speed_m_per_s, message):
    with pytest.raises(Refused, match=message):
        check_motion(HERE, FlangePose(position_m, (0.0, 0.0, 0.0)), speed_m_per_s, BOX)


def test_a_motion_that_starts_outside_of_the_workspace_is_refused():
    with pytest.raises(Refused, match="arm.start.z_m"):
        check_motion(FlangePose((0.0, 0.0, 0.31), (0.0, 0.0, 0.0)), HERE, 0.05, BOX)


def test_limits_that_make_no_sense_are_refused():
    with pytest.raises(Refused, match="must enclose 0"):
        CurrentLimits(1.0, 5.0, 10.0, 3.0, 100.0)
    with pytest.raises(Refused, match="continuous_A must be > 0"):
        CurrentLimits(0.0, 5.0, 10.0, 0.0, 100.0)
