"""The devices of a rig file open behind their limits, and unknown settings are refused."""

from __future__ import annotations

import copy
import os
import signal
import textwrap
import threading
import time
from functools import partial
from pathlib import Path

import pytest
import yaml

import drivers.open
from drivers.errors import DeviceFault, DriverError, Refused
from drivers.open import check_device, open_devices
from drivers.protocols import FlangePose
from drivers.pulse import SILENT_S
from drivers.simulated.hall import SimulatedF71
from drivers.simulated.process import Simulator
from drivers.simulated.supplies import simulated_kepco
from drivers.simulated.thermometers import Simulated224
from drivers.simulated.ur_server import serve_ur
from drivers.simulated.world import CoilCircuit, World
from tests.drivers.fields import along_z
from tests.drivers.rig import free_host
from tests.drivers.tcp_line import on_tcp

SUPPLY = {
    "supply": "kepco_bop",
    "highest_A": 5,
    "lowest_A": -5,
    "slew_A_per_s": 20,
    "continuous_A": 3,
    "thermal_time_constant_min": 5,
    "compliance_V": 20,
    "tolerance_mA": 1,
}
SENSOR = {"sensor": "lakeshore_f71", "range_mT": 350}
ARM = {
    "arm": "ur3e",
    "workspace_low_mm": [0, -300, 0],
    "workspace_high_mm": [500, 300, 500],
    "highest_speed_mm_per_s": 200,
}


@pytest.fixture
def world():
    return World([CoilCircuit(2.0, 0.0)], [FlangePose((0.3, 0.0, 0.2), (0.0, 3.0, 0.0))])


@pytest.fixture
def section(world):
    """Devices of a simulated rig."""
    with (
        on_tcp(partial(SimulatedF71, world, along_z)) as f71,
        Simulator.on_serial_line(partial(simulated_kepco, world, 0, 5.0)) as kepco,
        Simulator(partial(serve_ur, world, 0, "5.11.1.108318", free_host())) as ur,
    ):
        tcp_host, _, port = f71.address.rpartition(":")
        yield {
            "hall": {**SENSOR, "tcp": tcp_host, "port": int(port)},
            "coil1": {**SUPPLY, "serial": kepco.address},
            "arm1": {**ARM, "host": ur.address},
        }


def test_a_rig_is_opened_checked_and_measures(section, world):
    with open_devices(section) as devices:
        report = {name: ": ".join(check_device(device)) for name, device in devices.devices.items()}
        assert report["hall"].startswith("LSCI,F71")
        assert report["hall"].endswith("mT")
        assert report["coil1"] == "KEPCO,BOP 50-20M,A12345,2.1: 0 A"
        assert report["arm1"].endswith("300.00, 0.00, 200.00 mm")
        assert world.snapshot().currents_A == (0.0,)
        devices.arms["arm1"].move_to(
            FlangePose((0.3, 0.02, 0.2), (0.0, 3.0, 0.0)), speed_m_per_s=0.1, timeout_s=5.0
        )
        devices.sources["coil1"].set_current_A(2.0, timeout_s=3.0)
        assert devices.sources["coil1"]._tolerance_A == pytest.approx(1e-3 * SUPPLY["tolerance_mA"])
        field_T = devices.sensors["hall"].read_field_T(timeout_s=2.0).value
        assert field_T == pytest.approx(along_z(world.snapshot()), abs=1e-9)
        with pytest.raises(Refused, match="arm.target.y_m"):
            devices.arms["arm1"].move_to(
                FlangePose((0.3, 0.4, 0.2), (0.0, 3.0, 0.0)), speed_m_per_s=0.1, timeout_s=5.0
            )
    assert world.snapshot().currents_A == (0.0,)


def test_the_joint_limits_of_a_section_are_those_of_the_arm(section):
    """The joints of the simulated arm are the numbers of its pose."""
    section["arm1"] |= {"joint_low_deg": [-360, -2, *[-360] * 4], "joint_high_deg": [360, 2, *[360] * 4]}
    with open_devices(section) as devices:
        arm = devices.arms["arm1"]
        arm.move_to(FlangePose((0.3, 0.03, 0.2), (0.0, 3.0, 0.0)), speed_m_per_s=0.1, timeout_s=20.0)
        with pytest.raises(Refused, match=r"arm.joint_2_rad must be within -0.0349066 and 0.0349066"):
            arm.move_to(FlangePose((0.3, 0.05, 0.2), (0.0, 3.0, 0.0)), speed_m_per_s=0.1, timeout_s=20.0)
        assert devices.interlock.reason is None


def test_a_device_that_is_not_there_leaves_none_open(section):
    section["coil2"] = {**SUPPLY, "serial": "/dev/no_such_port"}
    with pytest.raises(DeviceFault, match="no_such_port"):
        open_devices(section)
    del section["coil2"]
    open_devices(section).close()  # all ports are free again


def test_an_arm_that_was_recorded_repeats_its_motion_within_the_limits_of_its_section(section, tmp_path):
    path = str(tmp_path / "arm1.txt")
    there = FlangePose((0.3, 0.02, 0.2), (0.0, 3.0, 0.0))
    beyond = FlangePose((0.3, 0.4, 0.2), (0.0, 3.0, 0.0))

    def moved(settings):
        with open_devices({"arm1": settings}) as devices, devices.watch():
            arm = devices.arms["arm1"]
            arm.move_to(there, speed_m_per_s=0.1, timeout_s=20.0)
            with pytest.raises(Refused, match="arm.target.y_m"):
                arm.move_to(beyond, speed_m_per_s=0.1, timeout_s=20.0)
            return arm.read_pose(timeout_s=2.0)

    reading = moved({**section["arm1"], "record": path})
    again = moved({**ARM, "replay": path})
    assert again.value.position_m == pytest.approx(there.position_m, abs=1e-6)
    assert (again.value, again.device_time_s, again.flags) == (
        reading.value,
        reading.device_time_s,
        reading.flags,
    )


def test_an_arm_whose_recording_cannot_be_written_is_not_left_open(section):
    arm = {**section["arm1"], "record": "/dev/null/arm1.txt"}
    n_threads = threading.active_count()
    with pytest.raises(OSError, match="arm1.txt"):
        open_devices({"arm1": arm})
    assert threading.active_count() == n_threads  # one reads the poses of an open arm


def test_a_thermometer_guards_its_coil_and_sensors_feel_themselves(section, world):
    with Simulator.on_serial_line(partial(Simulated224, world, {"B": 0})) as monitor:
        section["hall"]["own_temperature"] = True
        section["coil1"]["highest_temperature_C"] = 21.5
        section["warmth"] = {
            "thermometer": "lakeshore_224",
            "inputs": {"coil1": "B"},
            "serial": monitor.address,
        }
        with open_devices(section) as devices:
            assert sorted(devices.thermometers) == ["coil1", "hall"]
            assert devices.thermometers["hall"].read_temperature_K(timeout_s=2.0).value == pytest.approx(
                298.15, abs=0.2
            )
            with pytest.raises(
                DeviceFault, match=r"too hot: coil.temperature_C must be at most 21.5; it is 22."
            ):
                devices.sources["coil1"].set_current_A(1.0, timeout_s=3.0)
            identity, value = check_device(devices.devices["warmth"])
            assert identity == "LSCI,MODEL224,LSA224A/LSA224B,1.0"
            assert value.startswith("coil1 22.")
        assert world.snapshot().currents_A == (0.0,)


@pytest.mark.parametrize("sign", [signal.SIGSTOP, signal.SIGKILL])
def test_a_watch_notices_that_the_process_of_a_supply_is_stopped_or_dead_and_the_supply_is_switched_off(
    section, world, sign
):
    with open_devices({"coil1": section["coil1"]}) as devices, devices.watch():
        source = devices.sources["coil1"]
        source.set_current_A(2.0, timeout_s=5.0)
        os.kill(source._source.pid, sign)
        end_s = time.monotonic() + SILENT_S + 10.0
        while world.snapshot().currents_A != (0.0,):
            assert time.monotonic() < end_s, "nobody noticed"
            time.sleep(0.02)
        with pytest.raises(Refused, match="because coil1 failed: the process of coil1 must"):
            source.read_current_A(timeout_s=5.0)
    assert devices.interlock.not_at_rest == []


EMPTY = str(Path(drivers.open.__file__).with_name("py.typed"))  # a transcript of nothing
BAD = {
    "of no kind": ({"serial": "x"}, "must be a sensor, supply, arm or thermometer"),
    "of unknown kind": ({"sensor": "compass", "serial": "x"}, "sensor must be one of lakeshore_f71"),
    "without port": (SENSOR, "must have one of serial, tcp, visa and replay; received none"),
    "without messages": ({**SUPPLY, "supply": "korad_ka3005p", "lowest_A": 0, "visa": "GPIB0::6::INSTR"}, "must have one of serial, tcp and replay; received none"),
    "not there in VISA": ({"sensor": "metrolab_thm1176", "range_mT": 100, "visa": "USB0::0x1BFA::0x0498::none::INSTR"}, "none::INSTR must be there, once, and be permitted"),
    "with a serial line in VISA": ({**SENSOR, "visa": "ASRL/dev/ttyUSB0::INSTR"}, "visa must name a USB, GPIB or VXI-11 instrument"),
    "with two ports": ({**SENSOR, "serial": "x", "tcp": "y"}, "received serial and tcp"),
    "without unit": ({"sensor": "lakeshore_460", "range": 30, "serial": "x"}, "range_T must be given once, as range_T or range_mT"),
    "with two units": ({"sensor": "lakeshore_460", "range_T": 1, "range_mT": 30, "serial": "x"}, "must be given once"),
    "with text": ({"sensor": "lakeshore_460", "range_mT": "30", "serial": "x"}, "range_mT must hold finite numbers"),
    "without limit": ({key: value for key, value in SUPPLY.items() if key != "continuous_A"} | {"serial": "x"}, "continuous_A"),
    "without workspace": ({"arm": "ur3", "host": "x", "highest_speed_m_per_s": 1}, "workspace_low_m must be given"),
    "without host": (ARM, "bad must have one of host and replay; received none"),
    "with host and recording": ({**ARM, "host": "x", "replay": "y"}, "bad must have one of host and replay; received host and replay"),
    "without recording": ({**ARM, "replay": "/dev/none/arm1.txt"}, "arm1.txt must be readable as a transcript"),
    "not there": ({**SUPPLY, "serial": "/dev/no_such_port"}, "no_such_port must open"),
    "hot without thermometer": ({**SUPPLY, "highest_temperature_C": 80, "serial": "x"}, "highest_temperature_C must have a thermometer with an input for bad; there is none"),
    "without inputs": ({"thermometer": "lakeshore_224", "serial": "x"}, "inputs must be given"),
    "with an input that there is not": ({"thermometer": "lakeshore_224", "serial": "x", "inputs": ["A"]}, "must hold a text for each name"),
    "with a flag that is none": ({**SENSOR, "own_temperature": "yes", "replay": "/dev/null"}, "own_temperature must be true or false"),
    "that cannot feel itself": ({"sensor": "lakeshore_460", "range_mT": 30, "own_temperature": True, "replay": EMPTY}, "own_temperature must be left out"),
    "with a watchdog too fast": ({**SUPPLY, "supply": "scpi", "serial": "x", "watchdog_s": 3}, "watchdog_s must be whole seconds from 4 to 3600; received 3"),
    "with a watchdog between seconds": ({**SUPPLY, "supply": "scpi", "serial": "x", "watchdog_s": 4.5}, "whole seconds from 4 to 3600; received 4.5"),
    "with a watchdog that there is not": ({**SUPPLY, "serial": "x", "watchdog_s": 10}, "watchdog_s is not a known key"),
    "no mapping": ("f71", "must hold keys and values"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_a_device_that_is_badly_described_is_refused_by_name(case):
    mapping, message = BAD[case]
    with pytest.raises(DriverError, match=message):
        open_devices({"bad": copy.deepcopy(mapping)})


def test_a_key_that_nobody_knows_is_refused_and_the_device_closed(section):
    section["hall"]["colour"] = "red"
    with pytest.raises(Refused, match=r"devices.hall.colour is not a known key"):
        open_devices(section)


def test_a_misspelt_key_is_told_with_the_nearest(section):
    section["hall"]["own_temprature"] = True
    with pytest.raises(Refused, match=r"own_temprature is not a known key; the closest is own_temperature$"):
        open_devices(section)


def test_the_section_in_the_docstring_is_understood():
    """All of it except the ports, which do not exist."""
    text = textwrap.dedent(drivers.open.__doc__.partition("reads\n\n")[2])
    section = yaml.safe_load(text)["devices"]
    del section["arm1"]["joint_low_deg"]  # the text has no joint_high_deg
    warmth = {"warmth": {**section["warmth"], **LOCAL["warmth"]}}
    for name, settings in section.items():
        with pytest.raises(DeviceFault):
            open_devices(
                {
                    name: {**settings, **({"tcp": "127.0.0.1", "port": 1} if name == "hall" else {})}
                    | LOCAL[name]
                }
                | warmth
            )


LOCAL = {
    "hall": {},
    "coil1": {"serial": "/dev/no_such_port"},
    "arm1": {"host": "127.0.0.1"},
    "warmth": {"tcp": "127.0.0.1", "port": 1},
}
