"""A rig file is simulated as a whole and opened like a real rig."""

from __future__ import annotations

import time

import pytest

from drivers.errors import DeviceFault, DriverError, Refused
from drivers.open import check_device, open_devices
from drivers.protocols import FlangePose
from drivers.simulated.faults import Fault
from drivers.simulated.rig import SimulatedRig
from drivers.simulated.world import CoilCircuit
from tests.drivers.fields import SlowAtFirst, along_z
from tests.drivers.rig import free_host
from tests.drivers.test_open import ARM, SENSOR, SUPPLY

HOMES = [FlangePose((0.3, 0.0, 0.2), (0.0, 3.0, 0.0)), FlangePose((0.2, 0.1, 0.3), (0.0, 3.0, 0.0))]
SECTION = {
    "hall": {**SENSOR, "tcp": "192.0.2.7"},
    "fast": {
        "sensor": "senis_3mh6",
        "rate_Hz": 100,
        "range_number": 1,
        "full_scale_mT": 100,
        "serial": "/dev/none",
    },
    "coil1": {**SUPPLY, "serial": "/dev/none"},
    "coil2": {**SUPPLY, "supply": "korad_ka3005p", "lowest_A": 0, "serial": "/dev/none"},
    "arm1": {**ARM, "host": "192.0.2.8"},
    "arm2": {**ARM, "arm": "ur3", "host": "192.0.2.9"},
}
CIRCUITS = [CoilCircuit(2.0, 0.01), CoilCircuit(2.0, 0.01)]
FIELDS = {"hall": along_z, "fast": along_z}


@pytest.fixture
def rig():
    host = free_host()
    free_host()  # the second arm listens on the address after it
    with SimulatedRig(SECTION, FIELDS, circuits=CIRCUITS, homes=HOMES, first_host=host) as running:
        yield running


def test_all_its_devices_open_share_one_world_and_come_to_rest(rig):
    with open_devices(rig.section) as devices:
        assert sorted(devices.devices) == sorted(SECTION)
        for device in devices.devices.values():
            check_device(device)
        devices.sources["coil1"].set_current_A(1.0, timeout_s=3.0)
        devices.sources["coil2"].set_current_A(2.0, timeout_s=3.0)
        devices.arms["arm2"].move_to(
            FlangePose((0.2, 0.12, 0.3), (0.0, 3.0, 0.0)), speed_m_per_s=0.1, timeout_s=5.0
        )
        expected_T = pytest.approx(along_z(rig.world.snapshot()), abs=2e-5)
        assert devices.sensors["hall"].read_field_T(timeout_s=2.0).value == expected_T
        assert devices.sensors["fast"].read_field_T(timeout_s=2.0).value == expected_T
        assert devices.arms["arm1"].read_pose(timeout_s=2.0).value == HOMES[0]
        assert devices.arms["arm2"].read_pose(timeout_s=2.0).value.position_m[1] == pytest.approx(0.12)
    assert rig.world.snapshot().currents_A == pytest.approx((0.0, 0.0), abs=1e-6)


@pytest.mark.parametrize(
    ("device", "fault"), [("hall", Fault.DROP), ("coil1", Fault.DROP), ("arm1", Fault.MUTE)]
)
def test_a_fault_of_one_device_switches_off_all_currents(rig, device, fault):
    devices = open_devices(rig.section)
    devices.sources["coil2"].set_current_A(2.0, timeout_s=3.0)
    rig.simulators[device].faults.fault = fault
    with pytest.raises(DriverError):  # noqa: PT012
        for _ in range(20):
            devices.sensors["hall"].read_new_T(timeout_s=2.0)
            devices.sources["coil1"].read_current_A(timeout_s=2.0)
            devices.arms["arm1"].read_pose(timeout_s=2.0)
    assert devices.interlock.reason is not None
    assert rig.world.snapshot().currents_A[1] == pytest.approx(0.0, abs=1e-6)
    with pytest.raises(Refused, match="must be opened anew"):
        devices.sources["coil2"].set_current_A(1.0, timeout_s=3.0)
    if device == "coil1":
        with pytest.raises(DriverError):
            devices.close()
    else:
        devices.close()


def test_a_supply_that_switches_itself_off_brings_the_others_to_rest(rig):
    with open_devices(rig.section) as devices:
        devices.sources["coil1"].set_current_A(1.0, timeout_s=5.0)
        devices.sources["coil2"].set_current_A(2.0, timeout_s=5.0)
        assert devices.sources["coil2"].read_current_A(timeout_s=5.0).value == pytest.approx(2.0, abs=2e-3)
        rig.world.drive(1, 0.0)
        with pytest.raises(DeviceFault, match="coil2 delivers .* A where 2 A were set"):  # noqa: PT012
            for _ in range(100):  # its current dies away as the coil lets it
                devices.sources["coil2"].read_current_A(timeout_s=5.0)
        assert rig.world.snapshot().currents_A[0] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("fault", "sentence"),
    [
        (Fault.EMERGENCY_STOP, "emergency stop is pressed"),
        (Fault.PROTECTIVE_STOP, "protective stop"),
        (Fault.DROP, ""),
    ],
)
def test_an_arm_that_is_stopped_while_it_stands_switches_off_all_currents(rig, fault, sentence):
    with open_devices(rig.section) as devices, devices.watch():
        devices.sources["coil1"].set_current_A(2.0, timeout_s=5.0)
        rig.simulators["arm1"].faults.fault = fault
        end_s = time.monotonic() + 20.0
        while rig.world.snapshot().currents_A[0] > 1e-6:
            assert time.monotonic() < end_s, "the current still flows"
            time.sleep(0.02)
        with pytest.raises(Refused, match=f"because arm1 failed.*{sentence}"):
            devices.sources["coil1"].set_current_A(-2.0, timeout_s=5.0)


def test_what_is_missing_is_named():
    with pytest.raises(Refused, match="a circuit for each of 2 supplies"):
        SimulatedRig(SECTION, FIELDS, circuits=[], homes=HOMES)
    with pytest.raises(Refused, match="must know the field at hall; received none"):
        SimulatedRig(SECTION, {}, circuits=CIRCUITS, homes=HOMES)


def test_the_first_reading_with_a_current_waits_for_no_code_to_be_loaded():
    section = {"hall": SECTION["hall"], "coil1": SECTION["coil1"]}
    with SimulatedRig(section, {"hall": SlowAtFirst()}, circuits=CIRCUITS[:1], homes=[]) as running:
        running.world.drive(0, 1.0)
        with open_devices(running.section) as devices:
            devices.sensors["hall"].read_field_T(timeout_s=SlowAtFirst.LOADING_S - 0.5)
