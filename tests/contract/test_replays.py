"""A recording is a device too: opened as the rig file says, it is the instrument that was recorded, up to the end of the recording."""

from __future__ import annotations

import re
import time

import pytest

from drivers import entries
from drivers.errors import DeadlineExceeded, DeviceFault
from drivers.open import open_devices
from drivers.protocols import (
    CurrentSource,
    FieldSensor,
    FlangePose,
    ReadingFlag,
    RobotArm,
    TemperatureMonitor,
)
from drivers.simulated import rig as simulated
from drivers.simulated.rig import SimulatedRig
from drivers.simulated.world import CoilCircuit
from tests.drivers.fields import ROOM_T, along_z
from tests.drivers.rig import free_host
from tests.drivers.test_open import ARM, SENSOR, SUPPLY

TIMEOUT_S = 5.0
MOTION_S = 20.0
HOME = FlangePose((0.3, 0.0, 0.2), (0.0, 3.0, 0.0))
NEAR = FlangePose((0.3, 0.02, 0.2), (0.0, 3.0, 0.0))
SENIS = {"sensor": "senis_3mh6", "rate_Hz": 100, "range_number": 1, "full_scale_mT": 100}
SENSORS = {
    "f71": SENSOR,
    "460": {"sensor": "lakeshore_460", "range_mT": 30},
    "3mh6": SENIS,
    "thm1176": {"sensor": "metrolab_thm1176", "range_mT": 100},
}
SOURCES = {
    "kepco": SUPPLY,
    "korad": {**SUPPLY, "supply": "korad_ka3005p", "lowest_A": 0},
    "scpi": {**SUPPLY, "supply": "scpi", "lowest_A": 0},
}
ARMS = {"ur3": {**ARM, "arm": "ur3"}, "ur3e": ARM}
MONITOR = {"thermometer": "lakeshore_224", "inputs": {"device": "A"}}
KINDS = {**SENSORS, **SOURCES, **ARMS, "224": MONITOR}


class Session:
    """Opens a device, first with `record` and its simulator, then with `replay` and without."""

    def __init__(self, kind, path):
        self.kind, self.path = kind, path
        settings = KINDS[kind]
        coil = {} if "supply" in settings else {"coil": SUPPLY}  # the world has one, whoever drives it
        self.simulated = SimulatedRig(
            {"device": settings, **coil},
            {"device": along_z},
            circuits=[CoilCircuit(2.0, 0.0)],
            homes=[HOME] if "arm" in settings else [],
            first_host=free_host(),
        )

    def recorded(self):
        return open_devices({"device": {**self.simulated.section["device"], "record": str(self.path)}})

    def replayed(self):
        return open_devices({"device": {**KINDS[self.kind], "replay": str(self.path)}})

    def twice(self, use):
        """What `use` makes of the device, and what it makes of its recording."""
        with self.recorded() as devices:
            first = use(devices.devices["device"])
        self.simulated.close()
        with self.replayed() as devices:
            return first, use(devices.devices["device"])


@pytest.fixture
def session(request, tmp_path):
    opened = Session(request.param, tmp_path / "device.txt")
    yield opened
    opened.simulated.close()


def kinds(of):
    return pytest.mark.parametrize("session", of, indirect=True)


def lasting(readings):
    """What of readings does not depend on when they are read."""
    return repr(
        [(reading.sequence, reading.device_time_s, reading.value, reading.flags) for reading in readings]
    )


def test_every_model_is_simulated_and_recorded_here():
    """One that rig files may name needs a simulator in `drivers/simulated/rig.py`, and its settings in `SENSORS` or `SOURCES` above."""
    sensors = {settings["sensor"] for settings in SENSORS.values()}
    supplies = {settings["supply"] for settings in SOURCES.values()}
    assert set(entries.SENSORS) == set(simulated.SENSORS) == sensors
    assert set(entries.SUPPLIES) == set(simulated.SUPPLIES) == supplies


@kinds(KINDS)
def test_a_replay_identifies_itself_as_the_device_that_was_recorded(session):
    protocols = (FieldSensor, CurrentSource, RobotArm, TemperatureMonitor)

    def use(device):
        return device.identify(timeout_s=TIMEOUT_S), [isinstance(device, protocol) for protocol in protocols]

    first, again = session.twice(use)
    assert again == first
    assert sum(again[1]) == 1


@kinds(SENSORS)
def test_a_replayed_sensor_reads_what_was_read_counted_and_flagged_as_then(session):
    def use(sensor):
        readings = sensor.read_new_T(timeout_s=TIMEOUT_S)
        readings.append(sensor.read_field_T(timeout_s=TIMEOUT_S))
        return readings

    first, again = session.twice(use)
    n_read = (
        min(len(first), len(again)) if session.kind == "3mh6" else len(first)
    )  # a stream comes in other pieces
    assert lasting(again[:n_read]) == lasting(first[:n_read])
    assert [reading.sequence for reading in again] == list(range(len(again)))
    assert again[-1].value == pytest.approx(ROOM_T, abs=1e-8)
    times_s = [reading.host_monotonic_s for reading in again]
    assert times_s == sorted(times_s)
    assert times_s[0] > first[-1].host_monotonic_s  # they arrive now


@kinds(SENSORS)
def test_a_replayed_sensor_is_over_range_where_the_field_was(session):
    session.simulated.world.drive(0, 500.0)

    def use(sensor):
        return sensor.read_field_T(timeout_s=TIMEOUT_S)

    first, again = session.twice(use)
    assert ReadingFlag.OVER_RANGE in again.flags
    assert lasting([again]) == lasting([first])


@kinds(SOURCES)
def test_a_replayed_source_delivers_what_was_delivered(session):
    def use(source):
        source.set_current_A(2.0, timeout_s=TIMEOUT_S)
        readings = [source.read_current_A(timeout_s=TIMEOUT_S) for _ in range(2)]
        source.output_off(timeout_s=TIMEOUT_S)
        return readings

    first, again = session.twice(use)
    assert lasting(again) == lasting(first)
    assert again[-1].value == pytest.approx(2.0, abs=1e-3)
    assert again[1].sequence == again[0].sequence + 1


@kinds(ARMS)
def test_a_replayed_arm_is_where_it_was_counted_and_flagged_as_then(session):
    def use(arm):
        readings = [arm.read_pose(timeout_s=TIMEOUT_S) for _ in range(2)]
        arm.move_to(NEAR, speed_m_per_s=0.1, timeout_s=MOTION_S)
        return [*readings, arm.read_pose(timeout_s=TIMEOUT_S)]

    first, again = session.twice(use)
    assert lasting(again) == lasting(first)
    assert [reading.value for reading in again[:2]] == [HOME, HOME]
    assert again[2].value.position_m == pytest.approx(NEAR.position_m, abs=5e-4)


@kinds(["3mh6"])
@pytest.mark.parametrize("was_killed", [False, True])
def test_a_stream_ends_where_its_recording_does_and_says_so_in_a_sentence(session, was_killed):
    with session.recorded() as devices:
        first = devices.devices["device"].read_new_T(timeout_s=TIMEOUT_S)
    session.simulated.close()
    if was_killed:  # before it could end the stream
        lines = session.path.read_text().splitlines(keepends=True)
        assert lines.pop().endswith("> b'S'\n")
        session.path.write_text("".join(lines))
    replayed = session.replayed().devices["device"]
    readings = []
    begin_s = time.monotonic()
    with pytest.raises(DeadlineExceeded) as caught:  # noqa: PT012
        while len(readings) < 1000:
            readings += replayed.read_new_T(timeout_s=TIMEOUT_S)
    assert time.monotonic() - begin_s < TIMEOUT_S
    assert lasting(readings[: len(first)]) == lasting(first)
    end = f"the stream must go on within {TIMEOUT_S:g} s; the recording ends here ({session.path})"
    assert str(caught.value) == end


@kinds(KINDS)
def test_the_end_of_a_recording_is_one_sentence_with_its_file(session):
    with session.recorded() as devices:
        devices.devices["device"].identify(timeout_s=TIMEOUT_S)
    session.simulated.close()
    replayed = session.replayed().devices["device"]
    replayed.identify(timeout_s=TIMEOUT_S)
    with pytest.raises((DeviceFault, DeadlineExceeded), match="the recording ends here") as caught:
        replayed.identify(timeout_s=0.5)
    said = str(caught.value)
    assert re.search(re.escape(str(session.path)), said)
    assert "\n" not in said
