"""Devices in memory, for tests of the classes that wrap devices."""

from __future__ import annotations

from drivers.device import ClosesItself
from drivers.errors import DeadlineExceeded, DeviceFault
from drivers.protocols import FlangePose, ReadingFlag
from drivers.readings import ReadingCounter

HOME = FlangePose((0.3, 0.0, 0.4), (0.0, 0.0, 0.0))


class MemoryDevice(ClosesItself):
    """Lists the commands that it received in `told`."""

    def __init__(self):
        self.told = []
        self.counter = ReadingCounter()
        self.fault = None
        self.is_closed = False

    def identify(self, *, timeout_s):
        return f"coilcal tests, {type(self).__name__}, 0"

    def close(self):
        self.is_closed = True

    def obey(self, *command, timeout_s):
        if timeout_s <= 0:
            raise DeadlineExceeded("device must answer within 0 s; nothing received")
        self.told.append(command)
        if self.fault is not None:
            raise DeviceFault(self.fault)


class MemorySource(MemoryDevice):
    """Delivers a fraction (`share`) of the requested current."""

    slew_A_per_s = 10.0
    longest_off_s = 5.0
    share = 1.0
    current_A = 0.0
    flags = ReadingFlag.NONE

    def set_current_A(self, current_A, *, timeout_s):
        self.obey("set", current_A, timeout_s=timeout_s)
        self.current_A = self.share * current_A

    def read_current_A(self, *, timeout_s):
        return self.counter.reading(self.current_A, self.flags)

    def output_off(self, *, timeout_s):
        self.told.append(("off",))
        self.current_A = 0.0


class MemorySensor(MemoryDevice):
    """Reads zero."""

    def read_field_T(self, *, timeout_s):
        self.obey("read", timeout_s=timeout_s)
        return self.counter.reading((0.0, 0.0, 0.0))

    def read_new_T(self, *, timeout_s):
        return [self.read_field_T(timeout_s=timeout_s)]


class MemoryArm(MemoryDevice):
    """Arrives at once."""

    pose = HOME
    held_by = None

    def require_safe(self):
        if self.held_by is not None:
            raise DeviceFault(self.held_by)

    def read_pose(self, *, timeout_s):
        return self.counter.reading(self.pose)

    def move_to(self, base_from_flange, *, speed_m_per_s, timeout_s):
        self.obey("move", base_from_flange.position_m, timeout_s=timeout_s)
        self.pose = base_from_flange

    def stop(self, *, timeout_s):
        self.told.append(("stop",))
