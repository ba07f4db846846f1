"""Offset and delay of an instrument's clock are right while it drifts and after it is set."""

from __future__ import annotations

import random

import pytest

from estimator.acquisition.averages import WINDOW, DeviceClock


def test_a_reading_is_dated_within_the_spread_of_its_delays_while_the_clock_drifts():
    draw = random.Random(1)
    clock = DeviceClock()
    for number in range(20 * WINDOW):
        taken_s = 0.01 * number
        device_s = 1e9 + taken_s * (1.0 + 50e-6)
        clock.add(taken_s + 0.002 + draw.expovariate(1.0 / 0.005), device_s)
        if number > 20:
            assert clock.on_host_s(device_s) == pytest.approx(taken_s + 0.002, abs=2e-3)
    assert clock.delay_s == pytest.approx(0.005, abs=0.002)


@pytest.mark.parametrize("step_s", [-1.0, -0.3, 0.3, 1.0])
def test_a_clock_set_by_less_than_the_longest_delay_contradicts_the_times_of_the_requests(step_s):
    clock = DeviceClock()
    for number in range(100):
        taken_s = float(number)
        device_s = taken_s + 50.0 + (step_s if number >= 60 else 0.0)
        clock.add(taken_s + 0.004 + 0.002 * (number % 3), device_s, asked_s=taken_s - 0.01)
        assert clock.on_host_s(device_s) == pytest.approx(taken_s + 0.004, abs=0.005)
    assert clock.delay_s == pytest.approx(0.002, abs=0.001)


def test_a_reading_that_is_late_does_not_move_the_clock():
    clock = DeviceClock()
    for number, delay_s in enumerate((0.01, 1.5, 0.9, 0.01)):
        clock.add(number + delay_s, number + 50.0, asked_s=number - 0.01)
        assert clock.on_host_s(number + 50.0) == pytest.approx(number + 0.01)


@pytest.mark.parametrize("step_s", [3600.0, -3600.0])
def test_a_clock_that_is_set_is_believed_from_then_on(step_s):
    clock = DeviceClock()
    clock.add(10.0, 0.0)
    clock.add(11.0, 1.0 + step_s)
    assert clock.on_host_s(1.0 + step_s) == pytest.approx(11.0)
    assert clock.delay_s == 0.0
