"""The protocols of `drivers` tell devices apart, and readings are immutable."""

from __future__ import annotations

import dataclasses
import pickle

import pytest

from drivers.errors import DeadlineExceeded, DeviceFault, DriverError
from drivers.protocols import (
    CurrentSource,
    Device,
    FieldSensor,
    FlangePose,
    Reading,
    ReadingFlag,
    RobotArm,
)

FIELD_PER_CURRENT_T_PER_A = 2e-3
HOME = FlangePose((0.3, 0.0, 0.4), (0.0, 0.0, 0.0))


class MemoryDevice:
    """A device without hardware: counts its readings, and its clock ticks once for each."""

    def __init__(self):
        self.n_readings = 0
        self.is_closed = False

    def identify(self, *, timeout_s):
        return f"coilcal tests, {type(self).__name__}, 0"

    def close(self):
        self.is_closed = True

    def __enter__(self):
        return self

    def __exit__(self, exc_type, exc, traceback):
        self.close()

    def reading(self, value, flags=ReadingFlag.NONE):
        self.n_readings += 1
        return Reading(self.n_readings - 1, float(self.n_readings), None, value, flags)


class MemorySource(MemoryDevice):
    """Delivers the requested current, up to 5 A."""

    current_A = 0.0
    slew_A_per_s = 100.0
    longest_off_s = 1.0

    def set_current_A(self, current_A, *, timeout_s):
        if timeout_s <= 0:
            raise DeadlineExceeded(f"source.set_current_A must answer within {timeout_s} s; nothing received")
        if abs(current_A) > 5:
            raise DeviceFault(f"source.current_A must be within 5 A; received {current_A}")
        self.current_A = current_A

    def read_current_A(self, *, timeout_s):
        return self.reading(self.current_A)

    def output_off(self, *, timeout_s):
        self.current_A = 0.0

    def close(self):
        self.output_off(timeout_s=1.0)
        super().close()


class MemorySensor(MemoryDevice):
    """Sees a field along z in proportion to the current of one source, up to 8 mT."""

    def __init__(self, source):
        super().__init__()
        self.source = source

    def read_field_T(self, *, timeout_s):
        field_z_T = FIELD_PER_CURRENT_T_PER_A * self.source.current_A
        flags = ReadingFlag.OVER_RANGE if abs(field_z_T) > 8e-3 else ReadingFlag.NONE
        return self.reading((0.0, 0.0, field_z_T), flags)

    def read_new_T(self, *, timeout_s):
        return [self.read_field_T(timeout_s=timeout_s)]


class MemoryArm(MemoryDevice):
    """Arrives at once."""

    pose = HOME

    def read_pose(self, *, timeout_s):
        return self.reading(self.pose)

    def move_to(self, base_from_flange, *, speed_m_per_s, timeout_s):
        self.pose = base_from_flange

    def require_safe(self):
        pass

    def stop(self, *, timeout_s):
        pass


KINDS = {FieldSensor: lambda: MemorySensor(MemorySource()), CurrentSource: MemorySource, RobotArm: MemoryArm}


@pytest.mark.parametrize("made", KINDS)
@pytest.mark.parametrize("asked", KINDS)
def test_each_device_satisfies_its_own_protocol_and_no_other(made, asked):
    device = KINDS[made]()
    assert isinstance(device, Device)
    assert isinstance(device, asked) == (made is asked)


@pytest.mark.parametrize(
    "missing", ["identify", "close", "__enter__", "__exit__", "read_current_A", "output_off"]
)
def test_a_source_that_lacks_a_method_is_no_current_source(missing):
    methods = {name: method for cls in (MemoryDevice, MemorySource) for name, method in vars(cls).items()}
    incomplete = type("Incomplete", (), {name: method for name, method in methods.items() if name != missing})
    assert not isinstance(object.__new__(incomplete), CurrentSource)


def test_a_measurement_written_against_the_protocols_runs_on_devices_in_memory():
    with MemorySource() as source, MemorySensor(source) as sensor, MemoryArm() as arm:
        target = dataclasses.replace(HOME, position_m=(0.3, 0.1, 0.4))
        arm.move_to(target, speed_m_per_s=0.1, timeout_s=5.0)
        source.set_current_A(5.0, timeout_s=1.0)
        field = sensor.read_field_T(timeout_s=1.0)
        assert arm.read_pose(timeout_s=1.0).value == target
        assert source.read_current_A(timeout_s=1.0).value == 5.0
    assert field.value == (0.0, 0.0, pytest.approx(1e-2))
    assert field.flags == ReadingFlag.OVER_RANGE
    assert source.current_A == 0.0
    assert all(device.is_closed for device in (source, sensor, arm))


def test_every_fault_of_a_device_is_caught_as_a_driver_error():
    source = MemorySource()
    with pytest.raises(DriverError, match="within 5 A; received 6"):
        source.set_current_A(6.0, timeout_s=1.0)
    with pytest.raises(DriverError, match="within 0 s"):
        source.set_current_A(1.0, timeout_s=0)
    assert issubclass(DeadlineExceeded, TimeoutError)


def test_a_reading_cannot_be_made_without_saying_what_is_wrong_with_it():
    with pytest.raises(TypeError, match="flags"):
        Reading(0, 0.0, None, 1.0)


def test_a_reading_cannot_be_changed():
    reading = Reading(0, 0.0, None, 1.0, ReadingFlag.NONE)
    with pytest.raises(dataclasses.FrozenInstanceError):
        reading.value = 2.0


def test_a_reading_survives_the_way_to_another_process():
    reading = Reading(3, 1.5, 0.25, HOME, ReadingFlag.STALE | ReadingFlag.DROPPED)
    assert pickle.loads(pickle.dumps(reading)) == reading
