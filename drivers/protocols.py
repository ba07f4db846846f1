"""Protocols of the instruments of a coil rig: field sensor, current source, robot arm and thermometer.

Each call gets the time that it may take, `timeout_s`. It raises `drivers.errors.DeadlineExceeded` when that time is
over, and `DeviceFault` when the device reports a fault; after either, the state of the device is unknown. `Refused`
means that nothing was sent. A device is the only user of its port and serves one call at a time: other threads wait.
Leaving its `with` block closes it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Flag, auto
from types import TracebackType
from typing import Generic, Protocol, Self, TypeAlias, TypeVar, runtime_checkable

Value_co = TypeVar("Value_co", covariant=True)

Vector: TypeAlias = tuple[float, float, float]


class ReadingFlag(Flag):
    """Known defects of a reading."""

    NONE = 0
    STALE = auto()
    """The device repeated an old value instead of measuring a new one."""
    OVER_RANGE = auto()
    """The quantity exceeds the range of the device; a component without a number is NaN."""
    DROPPED = auto()
    """Readings of the device were lost between the previous one and this one."""


@dataclass(frozen=True, slots=True)
class Reading(Generic[Value_co]):
    """One value of one device, with its time stamps.

    Attributes:
        sequence: Count of the readings handed out by this device, from 0 and without gaps.
        host_monotonic_s: `time.monotonic()` of the host when the value arrived.
        device_time_s: Time stamp of the device on its own clock; None if it sends none.
        value: The quantity in SI units.
        flags: Known defects; `ReadingFlag.NONE` for none.

    Examples:
        >>> reading = Reading(0, 12.5, None, (0.0, 0.0, 0.1), ReadingFlag.STALE | ReadingFlag.OVER_RANGE)
        >>> ReadingFlag.OVER_RANGE in reading.flags, ReadingFlag.DROPPED in reading.flags
        (True, False)
    """

    sequence: int
    host_monotonic_s: float
    device_time_s: float | None
    value: Value_co
    flags: ReadingFlag


@dataclass(frozen=True, slots=True)
class FlangePose:
    """Pose of an arm's flange in the frame of the arm's base (base_from_flange).

    Attributes:
        position_m: Origin of the flange.
        rotation_vector_rad: Axis times angle, as Universal Robots reports it.
    """

    position_m: Vector
    rotation_vector_rad: Vector


@runtime_checkable
class Device(Protocol):
    """Any instrument."""

    def identify(self, *, timeout_s: float) -> str:
        """Maker, model and serial number as the device reports them."""
        ...

    def close(self) -> None:
        """Bring the device to rest (output off, motion stopped) and release it; a second call does nothing.

        A supply that was only read from, and never told to set a current or switch off, is left as it was.

        Raises:
            DriverError: The device is released, but is not known to be at rest.
        """
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, traceback: TracebackType | None
    ) -> None: ...


@runtime_checkable
class FieldSensor(Device, Protocol):
    """A magnetometer with three axes."""

    def read_field_T(self, *, timeout_s: float) -> Reading[Vector]:
        """Field along the sensor's own axes, measured after the call began.

        Earlier measurements that were not read are discarded without `DROPPED`, for they were not asked for.
        """
        ...

    def read_new_T(self, *, timeout_s: float) -> list[Reading[Vector]]:
        """All measurements since the last reading, oldest first; waits until there is one.

        Nothing is lost if it is called often enough; after a loss, the next reading carries `DROPPED`.
        """
        ...


@runtime_checkable
class CurrentSource(Device, Protocol):
    """A power supply that drives one coil."""

    @property
    def slew_A_per_s(self) -> float:
        """Highest rate of change of the current."""
        ...

    @property
    def longest_off_s(self) -> float:
        """Longest time that `output_off` takes, from the largest current."""
        ...

    def set_current_A(self, current_A: float, *, timeout_s: float) -> None:
        """Ramp to a current, with the output on; returns when the device has accepted the last set-point.

        Args:
            current_A: Positive out of the positive terminal; a unipolar supply refuses negative currents.
            timeout_s: Time the call may take.
        """
        ...

    def read_current_A(self, *, timeout_s: float) -> Reading[float]:
        """Current that the supply measures at its output, as opposed to the set-point."""
        ...

    def output_off(self, *, timeout_s: float) -> None:
        """Ramp the current to zero, then switch the output off; returns when the device reports it off."""
        ...


@runtime_checkable
class RobotArm(Device, Protocol):
    """An arm that carries a coil or a sensor on its flange."""

    def read_pose(self, *, timeout_s: float) -> Reading[FlangePose]:
        """Pose of the flange as the controller measures it, also during a motion."""
        ...

    def require_safe(self) -> None:
        """Check that no safety stop holds the arm and that its controller is heard; sends nothing and is fast.

        Raises:
            DriverError: A safety stop, named in the text, holds the arm, moving or not; or the controller has fallen silent.
        """
        ...

    def move_to(self, base_from_flange: FlangePose, *, speed_m_per_s: float, timeout_s: float) -> None:
        """Move the flange on a straight line; returns when the controller reports arrival.

        Args:
            base_from_flange: Pose to reach.
            speed_m_per_s: Highest speed of the flange's origin.
            timeout_s: Time the motion may take, from the call to arrival.

        Raises:
            DeadlineExceeded: The arm may still be moving; call `stop` next.
        """
        ...

    def stop(self, *, timeout_s: float) -> None:
        """Brake; returns when the controller reports that the arm stands still."""
        ...


@runtime_checkable
class Thermometer(Protocol):
    """Measures the temperature of one coil or sensor; one instrument may hold several thermometers."""

    def read_temperature_K(self, *, timeout_s: float) -> Reading[float]:
        """The temperature measured last; NaN if the instrument has no number."""
        ...


@runtime_checkable
class TemperatureMonitor(Device, Protocol):
    """An instrument that only measures temperatures."""

    @property
    def thermometers(self) -> Mapping[str, Thermometer]:
        """Thermometers by the coil or sensor that each is fixed to."""
        ...
