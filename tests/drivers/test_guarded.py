"""A fault of any device brings the whole rig to rest, and every later command is refused."""

from __future__ import annotations

import os
import signal
import threading
import time

import numpy as np
import pytest

from drivers.errors import DeviceFault, Refused
from drivers.guarded import GuardedArm, GuardedSensor, GuardedSource, GuardedThermometer
from drivers.interlock import Interlock, Watch, sigterm_as_exception
from drivers.protocols import CurrentSource, FieldSensor, FlangePose, ReadingFlag, RobotArm
from drivers.safety import ArmLimits, CoilLoad, CurrentLimits
from tests.drivers.memory import HOME, MemoryArm, MemorySensor, MemorySource

LIMITS = CurrentLimits(-5.0, 5.0, 10.0, continuous_A=3.0, thermal_time_constant_s=10.0)
BOX = ArmLimits((0.0, -0.5, 0.0), (0.5, 0.5, 0.5), highest_speed_m_per_s=0.1)
TARGET = FlangePose((0.3, 0.1, 0.4), (0.0, 0.0, 0.0))


class Rig:
    def __init__(self, limits=LIMITS, thermometer=None):
        self.interlock = Interlock()
        self.memory_source, self.memory_arm, self.memory_sensor = MemorySource(), MemoryArm(), MemorySensor()
        self.source = GuardedSource(
            self.memory_source,
            limits,
            self.interlock,
            name="coil1",
            tolerance_A=0.01,
            read_temperature_K=thermometer,
        )
        self.arm = GuardedArm(self.memory_arm, BOX, self.interlock, name="arm")
        self.sensor = GuardedSensor(self.memory_sensor, self.interlock, name="hall")

    def use(self):
        self.source.set_current_A(2.0, timeout_s=0.2)
        self.arm.move_to(TARGET, speed_m_per_s=0.05, timeout_s=1.0)
        self.sensor.read_field_T(timeout_s=1.0)

    @property
    def is_at_rest(self):
        return self.memory_source.told[-1] == ("off",) and self.memory_arm.told[-1] == ("stop",)


def test_guarded_devices_are_devices():
    rig = Rig()
    assert isinstance(rig.source, CurrentSource)
    assert isinstance(rig.arm, RobotArm)
    assert isinstance(rig.sensor, FieldSensor)
    rig.use()
    assert rig.interlock.reason is None


@pytest.mark.parametrize("faulty", ["memory_source", "memory_arm", "memory_sensor"])
def test_a_fault_of_any_device_brings_all_to_rest(faulty):
    rig = Rig()
    rig.use()
    getattr(rig, faulty).fault = "the cable is out"
    with pytest.raises(DeviceFault, match="the cable is out"):
        rig.use()
    assert rig.is_at_rest
    assert "the cable is out" in rig.interlock.reason
    getattr(rig, faulty).fault = None
    for use in (
        lambda: rig.source.set_current_A(0.0, timeout_s=1.0),
        lambda: rig.arm.move_to(HOME, speed_m_per_s=0.05, timeout_s=1.0),
        lambda: rig.sensor.read_field_T(timeout_s=1.0),
    ):
        with pytest.raises(Refused, match="must be opened anew.*the cable is out"):
            use()


def test_what_is_refused_sends_nothing_and_trips_nothing():
    rig = Rig()
    with pytest.raises(Refused):
        rig.source.set_current_A(6.0, timeout_s=1.0)
    with pytest.raises(Refused):
        rig.arm.move_to(FlangePose((0.6, 0.0, 0.4), (0.0, 0.0, 0.0)), speed_m_per_s=0.05, timeout_s=1.0)
    assert rig.memory_source.told == []
    assert rig.memory_arm.told == []
    assert rig.interlock.reason is None


def test_a_current_that_does_not_come_trips():
    rig = Rig()
    rig.memory_source.share = 0.9
    with pytest.raises(DeviceFault, match=r"coil1 must carry 2 A within 0.2 s; it measures 1.8 A"):
        rig.source.set_current_A(2.0, timeout_s=0.2)
    assert rig.is_at_rest


def test_a_supply_that_switches_itself_off_is_found_out_where_its_current_is_read():
    rig = Rig()
    rig.use()
    rig.source.read_current_A(timeout_s=1.0)
    rig.memory_source.current_A = 0.0
    with pytest.raises(
        DeviceFault, match="coil1 delivers 0 A where 2 A were set: it has switched itself off or is limited"
    ):
        rig.source.read_current_A(timeout_s=1.0)
    assert rig.is_at_rest


def test_a_current_that_the_voltage_limit_holds_back_trips():
    rig = Rig()
    rig.use()
    rig.memory_source.flags = ReadingFlag.OVER_RANGE
    with pytest.raises(DeviceFault, match="coil1 delivers 2 A where 2 A were set: its voltage limit"):
        rig.source.read_current_A(timeout_s=1.0)
    assert rig.is_at_rest
    rig = Rig()
    rig.memory_source.flags = ReadingFlag.OVER_RANGE
    with pytest.raises(DeviceFault, match="measures 2 A, held back by its voltage limit"):
        rig.source.set_current_A(2.0, timeout_s=0.2)


def test_nothing_is_expected_of_a_supply_that_was_not_asked_or_was_switched_off():
    rig = Rig()
    rig.memory_source.current_A = 1.3
    assert rig.source.read_current_A(timeout_s=1.0).value == 1.3
    rig.use()
    rig.source.output_off(timeout_s=1.0)
    assert rig.source.read_current_A(timeout_s=1.0).value == 0.0


def test_a_coil_that_gets_too_hot_trips_while_it_is_read():
    temperature_K = [300.0]
    limits = CurrentLimits(-5.0, 5.0, 10.0, 3.0, 100.0, highest_temperature_K=350.0)
    rig = Rig(limits, lambda: temperature_K[0])
    rig.use()
    temperature_K[0] = 351.0
    with pytest.raises(DeviceFault, match="too hot: coil.temperature_C must be at most 76.85; it is 77.85"):
        rig.source.read_current_A(timeout_s=1.0)
    assert rig.is_at_rest


HOT_LIMITS = CurrentLimits(-5.0, 5.0, 10.0, 3.0, 100.0, highest_temperature_K=350.0)


@pytest.mark.parametrize("temperature_K", [351.0, np.nan])
def test_no_current_is_set_in_a_coil_that_is_too_hot_or_of_unknown_temperature(temperature_K):
    rig = Rig(HOT_LIMITS, lambda: temperature_K)
    with pytest.raises(DeviceFault, match="too hot|must have a thermometer that gives a number"):
        rig.source.set_current_A(2.0, timeout_s=0.2)
    assert rig.memory_source.told == [("off",)]


def test_the_thermometer_is_asked_before_each_current_and_not_only_while_it_flows():
    order = []

    def read_K():
        order.append("thermometer")
        return 300.0

    rig = Rig(HOT_LIMITS, read_K)
    tell = rig.memory_source.set_current_A

    def set_current_A(current_A, *, timeout_s):
        order.append("current")
        tell(current_A, timeout_s=timeout_s)

    rig.memory_source.set_current_A = set_current_A
    for current_A in (2.0, -2.0):
        order.clear()
        rig.source.set_current_A(current_A, timeout_s=0.2)
        assert order[:2] == ["thermometer", "current"]
        assert order[2:] == ["thermometer"]


def test_a_thermometer_that_fails_before_a_current_keeps_it_from_being_set():
    def read_K():
        raise DeviceFault("the cable is out")

    rig = Rig(HOT_LIMITS, read_K)
    with pytest.raises(DeviceFault, match="the cable is out"):
        rig.source.set_current_A(2.0, timeout_s=0.2)
    assert rig.memory_source.told == [("off",)]


def test_a_coil_that_gets_too_hot_while_nobody_asks_trips_and_who_measures_waits_until_all_is_at_rest():
    temperature_K = [300.0]
    rig = Rig(
        CurrentLimits(-5.0, 5.0, 10.0, 3.0, 100.0, highest_temperature_K=350.0), lambda: temperature_K[0]
    )
    rig.use()
    slow = rig.memory_source.output_off

    def off(*, timeout_s):
        time.sleep(0.3)
        slow(timeout_s=timeout_s)

    rig.memory_source.output_off = off
    with Watch([rig.source.check_coil], every_s=0.02):
        time.sleep(0.1)
        assert rig.interlock.reason is None
        temperature_K[0] = 351.0
        with pytest.raises(Refused, match="must be opened anew.*because coil1 failed: the coil is too hot"):  # noqa: PT012
            for _ in range(200):
                rig.sensor.read_field_T(timeout_s=1.0)
                time.sleep(0.01)
        assert rig.is_at_rest
    assert rig.interlock.not_at_rest == []


def test_an_arm_that_is_held_while_it_stands_brings_all_to_rest_and_no_current_is_taken_after():
    rig = Rig()
    rig.use()
    rig.memory_arm.held_by = "its emergency stop is pressed"
    with Watch([rig.interlock.check_conditions], every_s=0.01):
        end_s = time.monotonic() + 10.0
        while not rig.is_at_rest:
            assert time.monotonic() < end_s, "nobody noticed"
            time.sleep(0.01)
    n_told = len(rig.memory_source.told)
    with pytest.raises(Refused, match="because arm failed: its emergency stop is pressed"):
        rig.source.set_current_A(-2.0, timeout_s=0.2)
    assert len(rig.memory_source.told) == n_told


def test_no_current_is_set_beside_an_arm_that_is_held_even_where_nobody_watches():
    rig = Rig()
    rig.memory_arm.held_by = "its emergency stop is pressed"
    with pytest.raises(DeviceFault, match="emergency stop"):
        rig.source.set_current_A(2.0, timeout_s=0.2)
    assert ("set", 2.0) not in rig.memory_source.told
    assert rig.interlock.reason == "arm failed: its emergency stop is pressed"


def test_a_source_gets_the_time_that_its_ramp_takes_to_come_to_rest():
    source, allowed_s = MemorySource(), []
    source.longest_off_s = 80.0
    source.output_off = lambda *, timeout_s: allowed_s.append(timeout_s)
    interlock = Interlock()
    GuardedSource(source, LIMITS, interlock, name="coil1", tolerance_A=0.01)
    interlock.trip("of a test")
    assert allowed_s == [80.0]


def test_a_second_fault_waits_until_the_first_has_brought_all_to_rest():
    rig = Rig()
    rig.use()
    slow = rig.memory_source.output_off
    rig.memory_source.output_off = lambda **arguments: (time.sleep(0.3), slow(**arguments))
    first = threading.Thread(target=rig.interlock.trip, args=("of the first",))
    first.start()
    time.sleep(0.05)
    rig.interlock.trip("of the second")
    assert rig.is_at_rest
    assert rig.interlock.reason == "of the first"
    first.join()


def test_a_thermometer_that_fails_brings_all_to_rest():
    class Broken:
        def read_temperature_K(self, *, timeout_s):
            raise DeviceFault("the cable is out")

    rig = Rig()
    rig.use()
    with pytest.raises(DeviceFault, match="the cable is out"):
        GuardedThermometer(Broken(), rig.interlock, name="the thermometer of coil1").read_temperature_K(
            timeout_s=1.0
        )
    assert rig.is_at_rest
    assert rig.interlock.reason == "the thermometer of coil1 failed: the cable is out"


def test_a_coil_that_carries_too_much_for_too_long_trips():
    rig = Rig(CurrentLimits(-5.0, 5.0, 10.0, continuous_A=1.0, thermal_time_constant_s=1.5))
    rig.source.set_current_A(1.2, timeout_s=0.2)
    with pytest.raises(DeviceFault, match="must cool"):  # noqa: PT012
        for _ in range(100):
            rig.source.read_current_A(timeout_s=1.0)
            time.sleep(0.05)
    assert rig.is_at_rest


def test_a_coil_that_carries_too_much_for_too_long_trips_even_where_nobody_reads_its_current():
    rig = Rig(CurrentLimits(-5.0, 5.0, 10.0, continuous_A=1.0, thermal_time_constant_s=1.5))
    rig.source.set_current_A(1.2, timeout_s=5.0)
    with Watch([rig.source.check_coil], every_s=0.01):
        end_s = time.monotonic() + 20.0
        while not rig.is_at_rest:
            assert time.monotonic() < end_s, "nobody noticed"
            time.sleep(0.01)
    assert "coil1 must cool" in rig.interlock.reason


def test_what_a_coil_carried_before_counts():
    cold, warm = Rig(), Rig()
    warm.source.begin_with(CoilLoad(-1e6, 8.9))
    cold.source.set_current_A(5.0, timeout_s=5.0)
    with pytest.raises(Refused, match="must leave time to cool: 5 A may flow for"):
        warm.source.set_current_A(5.0, timeout_s=5.0)


def test_a_source_that_ramps_too_fast_or_lacks_its_thermometer_is_refused():
    with pytest.raises(Refused, match="slew_A_per_s must be at most 1"):
        Rig(CurrentLimits(-5.0, 5.0, 1.0, 3.0, 100.0))
    with pytest.raises(Refused, match="thermometer"):
        Rig(CurrentLimits(-5.0, 5.0, 10.0, 3.0, 100.0, highest_temperature_K=350.0))


def test_ctrl_c_brings_the_rig_to_rest():
    rig = Rig()
    rig.use()
    rig.memory_sensor.read_field_T = lambda **_: signal.raise_signal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        rig.sensor.read_field_T(timeout_s=1.0)
    assert rig.is_at_rest
    assert rig.interlock.reason == "the program was interrupted"


def test_sigterm_unwinds_all_blocks():
    with pytest.raises(SystemExit) as caught, sigterm_as_exception(), MemorySource() as source:  # noqa: PT012
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(1.0)
    assert caught.value.code == 128 + signal.SIGTERM
    assert source.is_closed


def test_one_device_that_cannot_be_brought_to_rest_does_not_keep_the_others_from_it():
    rig = Rig()

    def fail():
        raise DeviceFault("supply must answer")

    rig.interlock.add("coil2", fail)
    rig.interlock.trip("of a test")
    assert rig.is_at_rest
    assert rig.interlock.not_at_rest == ["coil2 is not known to be at rest: supply must answer"]


def test_devices_are_brought_to_rest_at_the_same_time():
    interlock = Interlock()
    meeting = threading.Barrier(3, timeout=5.0)
    for name in "abc":
        interlock.add(name, meeting.wait)
    interlock.trip("of a test")
    assert interlock.not_at_rest == []


@pytest.mark.parametrize(
    ("delivered_A", "is_right"), [(2.0099, True), (1.9901, True), (2.0101, False), (1.9899, False)]
)
def test_a_current_is_right_within_the_tolerance_and_not_a_hundredth_beyond(delivered_A, is_right):
    rig = Rig()
    rig.use()
    rig.memory_source.current_A = delivered_A
    if is_right:
        rig.source.read_current_A(timeout_s=1.0)
        return
    with pytest.raises(DeviceFault, match="where 2 A were set"):
        rig.source.read_current_A(timeout_s=1.0)


def test_what_a_coil_carried_counts_after_it_was_switched_off(monkeypatch):
    """Five amperes through a whole thermal time constant leave 63 % of their load, whatever was asked in between."""
    clock_s = [1000.0]
    monkeypatch.setattr("drivers.guarded.time.monotonic", lambda: clock_s[0])
    limits = CurrentLimits(-5.0, 5.0, 10.0, continuous_A=4.5, thermal_time_constant_s=10.0)
    rig = Rig(limits)
    rig.source.set_current_A(5.0, timeout_s=5.0)
    clock_s[0] += 10.0
    rig.source.output_off(timeout_s=5.0)
    rested = CoilLoad(0.0, 25.0 * (1.0 - np.exp(-1.0)))
    assert rig.source._update_load(0.0).mean_square_A2 == pytest.approx(rested.mean_square_A2)
    clock_s[0] += 5.0
    assert rig.source._update_load(0.0).mean_square_A2 == pytest.approx(rested.mean_square_A2 * np.exp(-0.5))
