"""What the journal holds of a stop: averages, dates, temperatures, and whether the field had settled."""

from __future__ import annotations

import math
import random
import time
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from drivers.protocols import ReadingFlag
from estimator.acquisition.acquire import Progress
from estimator.acquisition.averages import is_settled
from estimator.acquisition.pace import FEWEST_READINGS
from estimator.store.growing import StopReadings, observations_of
from estimator.store.session import load_session, seal
from tests.drivers.memory import MemoryArm, MemorySensor
from tests.estimator.acquisition.measured import Scripted, rig_of_devices


@pytest.mark.parametrize("value", [9.91e37, -9.9e37, 1e300, math.inf, math.nan])
def test_a_number_that_stands_for_none_is_not_measured_and_the_session_opens_again(run, value):
    run.devices = rig_of_devices(Scripted((1e-3, value, 2e-3)))
    answer = SimpleNamespace(value=value)
    run.devices.thermometers = {"coil1": SimpleNamespace(read_temperature_K=lambda *, timeout_s: answer)}
    run.measure()
    sealed = seal(run.folder)
    readings = run.readings
    assert load_session(run.folder).hash == sealed.hash
    assert readings.is_measured.tolist() == [[True, False, True]] * len(run.stops)
    assert bool(readings.temperature_C["coil1"].isnan().all())


def test_temperatures_are_recorded_with_every_reading(run):
    class Warming:
        """Reads a kelvin more each time; the second reading has no number."""

        n_read = 0

        def read_temperature_K(self, *, timeout_s: float) -> Any:
            self.n_read += 1
            value_K = math.nan if self.n_read == 2 else 293.15 + self.n_read
            return MemorySensor().counter.reading(value_K)

    run.devices.thermometers["coil1"] = Warming()
    run.measure()
    growing = run.readings
    seal(run.folder)
    for readings in (growing, run.readings):
        assert list(readings.temperature_C) == ["coil1"]
        assert readings.temperature_C["coil1"].tolist() == pytest.approx([21.0, math.nan, 23.0], nan_ok=True)


def test_a_thermometer_added_while_a_session_is_interrupted_has_no_earlier_readings(small_rig):
    entries = [
        StopReadings(float(i), [1.0], {"arm1": [0.0] * 6}, {"hall": [0.0] * 3}, False, 0).entry()
        for i in range(2)
    ]
    del entries[0]["temperature_C"]  # as in journals of earlier versions
    entries[1]["temperature_C"] = {"coil1": 25.0}
    temperature_C = observations_of(entries, small_rig).temperature_C["coil1"]
    assert temperature_C.tolist() == pytest.approx([math.nan, 25.0], nan_ok=True)


def test_readings_are_averaged_without_those_that_repeat(run):
    values = [
        (0.0, 0.0, 1e-3),
        (0.0, 0.0, 3e-3),
        ((9.0, 9.0, 9.0), ReadingFlag.STALE),
        *[(0.0, 0.0, 1e-3), (0.0, 0.0, 3e-3)] * 2,
    ]
    entry = run.first_entry(Scripted(*values))
    assert entry["field_T"]["hall"] == pytest.approx([0.0, 0.0, 2e-3])
    assert entry["sd_T"]["hall"][2] == pytest.approx(1e-3 * math.sqrt(6 / 5))
    assert entry["is_settled"]


def test_a_stop_is_dated_by_the_clock_of_its_instrument(run):
    class Late(MemorySensor):
        """Delivers its readings 20 ms after it took them, but the first at once; its clock counts from 1970."""

        n_read = 0

        def read_field_T(self, *, timeout_s: float) -> Any:
            self.n_read += 1
            now_s = time.monotonic()
            taken_s = now_s if self.n_read == 1 else now_s - 0.02
            return self.counter.reading((0.0, 0.0, 1e-3), host_monotonic_s=now_s, device_time_s=taken_s + 1e9)

    entry = run.first_entry(Late(), n_readings=10)
    assert entry["delay_s"]["hall"] == pytest.approx(0.018, abs=1e-3)
    again = replace(run, folder=run.folder.with_name("again")).first_entry(MemorySensor())
    assert again["delay_s"] == {}  # neither the sensor nor the arm has a clock


def test_how_old_a_reading_may_be_is_in_the_journal(run):
    class Slow(MemorySensor):
        def read_field_T(self, *, timeout_s: float) -> Any:
            time.sleep(0.05)
            return super().read_field_T(timeout_s=timeout_s)

    entry = run.first_entry(Slow())
    assert sorted(entry["answer_s"]) == ["arm1", "coil1", "hall"]
    assert entry["answer_s"]["hall"] >= 0.05
    assert 0.0 < entry["answer_s"]["coil1"] < entry["end_s"] - entry["begin_s"]


@pytest.mark.parametrize("step_s", [-1.5, -0.5, 0.5, 1.5])
def test_times_increase_even_if_the_clock_of_an_instrument_is_set(run, step_s):
    class Set(MemorySensor):
        """Its clock is set before the second stop."""

        step_s = 0.0

        def read_field_T(self, *, timeout_s: float) -> Any:
            now_s = time.monotonic()
            return self.counter.reading(
                (0.0, 0.0, 1e-3), host_monotonic_s=now_s, device_time_s=now_s + self.step_s
            )

    run.devices = rig_of_devices(Set())

    def set_clock(_: Progress) -> None:
        run.devices.sensors["hall"].step_s = step_s

    begin_s = time.monotonic()
    times_s = [entry["time_s"] for entry in run.measure(set_clock)]
    assert times_s == sorted(times_s)
    assert 0.0 < times_s[-1] < time.monotonic() - begin_s


@pytest.mark.parametrize(("step_m", "is_same"), [(3e-6, True), (1e-4, False)])
def test_an_arm_that_stands_still_keeps_its_pose_unless_it_was_bumped(run, step_m, is_same):
    class Trembling(MemoryArm):
        n_read = 0

        def read_pose(self, *, timeout_s: float) -> Any:
            self.n_read += 1
            x_m, y_m, z_m = self.pose.position_m
            return self.counter.reading(replace(self.pose, position_m=(x_m + step_m * self.n_read, y_m, z_m)))

    run.devices.arms["arm1"] = Trembling()
    first, second, third = (entry["motion"]["arm1"] for entry in run.measure())
    assert (first == second) is is_same
    assert second != third


def test_a_field_that_settles_late_is_waited_for(run):
    falling = [(0.0, 0.0, 1e-3 * 2.0**-i) for i in range(20)]
    entry = run.first_entry(Scripted(*falling, (0.0, 0.0, 0.0)), 12)
    assert entry["is_settled"]
    assert entry["field_T"]["hall"][2] < 1e-8


@pytest.mark.parametrize("n_readings", [FEWEST_READINGS, FEWEST_READINGS + 1, 10, 50])
@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_a_field_that_changes_steadily_has_not_settled_for_any_number_of_readings(run, n_readings, noise):
    draw = random.Random(3)
    rising = [(0.0, 0.0, 1e-6 * (i + draw.gauss(0.0, noise))) for i in range(100_000)]
    entry = run.first_entry(Scripted(*rising), n_readings)
    assert not entry["is_settled"]


def test_noise_alone_is_taken_for_a_change_at_few_stops():
    draw = torch.Generator().manual_seed(5)
    field_T = torch.randn(2000, FEWEST_READINGS, 3, generator=draw, dtype=torch.float64)
    n_changing = sum(not is_settled(readings_T) for readings_T in field_T)
    assert n_changing < 0.03 * len(field_T)


def test_what_left_the_range_is_not_measured(run):
    over = ((math.nan, 1e-3, 2e-3), ReadingFlag.OVER_RANGE)
    entry = run.first_entry(Scripted(over))
    assert entry["field_T"]["hall"] == [None, pytest.approx(1e-3), pytest.approx(2e-3)]


def test_what_an_instrument_lost_is_counted_in_the_journal(run):
    good = (0.0, 0.0, 1e-3)
    lossy = [good, good, (good, ReadingFlag.DROPPED), (good, ReadingFlag.DROPPED | ReadingFlag.STALE), good]
    entry = run.first_entry(Scripted(*lossy))
    assert entry["n_gaps"] == {"hall": 2}
    again = replace(run, folder=run.folder.with_name("again")).first_entry(
        Scripted((good, ReadingFlag.DROPPED), good)
    )
    assert again["n_gaps"] == {"hall": 0}  # losses before the first reading do not count


def test_an_overload_without_a_component_takes_all_three(run):
    entry = run.first_entry(Scripted(((1e-3, 1e-3, 2e-3), ReadingFlag.OVER_RANGE)))
    assert entry["field_T"]["hall"] == [None, None, None]
