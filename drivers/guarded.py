"""Devices behind the limits of their rig: each command is checked before it is sent, and its effect is read back."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from drivers.deadline import Deadline
from drivers.device import ClosesItself
from drivers.errors import DeviceFault, Refused
from drivers.interlock import Interlock
from drivers.protocols import (
    CurrentSource,
    FieldSensor,
    FlangePose,
    Reading,
    ReadingFlag,
    RobotArm,
    Thermometer,
    Vector,
)
from drivers.safety import ArmLimits, CoilLoad, CurrentLimits, check_current, check_motion, check_temperature

_STOP_S = 3.0
_POLL_S = 0.05


class GuardedSource(ClosesItself):
    """A `CurrentSource` within limits; any fault of the source or the rig ramps it to zero and switches it off."""

    def __init__(
        self,
        source: CurrentSource,
        limits: CurrentLimits,
        interlock: Interlock,
        *,
        name: str,
        tolerance_A: float,
        hold_s: float = 1.0,
        read_temperature_K: Callable[[], float] | None = None,
    ) -> None:
        """Wrap a source.

        Args:
            source: Must not change its current faster than the limits allow.
            limits: Of the coil.
            interlock: Of the rig.
            name: The operator's name for the source.
            tolerance_A: Largest difference between measured and requested current: accuracy, resolution and noise of the supply.
            hold_s: A current is allowed only if the coil can bear it for at least this long.
            read_temperature_K: Thermometer of the coil; required if the limits state a temperature.
        """
        if source.slew_A_per_s > limits.slew_A_per_s:
            raise Refused(
                f"{name}.slew_A_per_s must be at most {limits.slew_A_per_s:g}; the source ramps with {source.slew_A_per_s:g}"
            )
        if limits.highest_temperature_K is not None and read_temperature_K is None:
            raise Refused(
                f"{name} must have a thermometer because its limits state a temperature; it has none"
            )
        self.slew_A_per_s, self.longest_off_s = source.slew_A_per_s, source.longest_off_s
        self._source, self._limits, self._interlock, self._name = source, limits, interlock, name
        self._tolerance_A, self._hold_s, self._read_temperature_K = tolerance_A, hold_s, read_temperature_K
        # A coil of unknown history is taken to be cold, for rigs are switched on in the morning; see `begin_with`.
        self._load_lock = threading.Lock()  # shared with the thread of `drivers.interlock`
        self._load = CoilLoad(time.monotonic(), 0.0)
        self._flowing_A = 0.0
        self._requested_A: float | None = None
        """Current that must flow; None during a change, and before the first request."""
        interlock.add(name, lambda: source.output_off(timeout_s=source.longest_off_s))

    def identify(self, *, timeout_s: float) -> str:
        """See `Device.identify`."""
        return self._source.identify(timeout_s=timeout_s)

    def set_current_A(self, current_A: float, *, timeout_s: float) -> None:
        """See `CurrentSource.set_current_A`; returns when the measured current has reached the target.

        Raises:
            Refused: The current is beyond a limit, or the rig has tripped; nothing was sent.
            DeviceFault: The current was not reached; the rig is brought to rest.
        """
        deadline = Deadline.after(timeout_s)
        self._interlock.require_no_trip()
        check_current(current_A, self._hold_s, self._update_load(self._flowing_A), self._limits)
        with self._interlock.guard(self._name):
            self._check_temperature()
            # Until the ramp has ended, no more than the greater of the two currents flows.
            self._flowing_A = max(abs(current_A), abs(self._flowing_A))
            self._requested_A = None
            self._source.set_current_A(current_A, timeout_s=deadline.remaining_s)
            self._wait_for(current_A, deadline)
            self._requested_A = current_A

    def read_current_A(self, *, timeout_s: float) -> Reading[float]:
        """See `CurrentSource.read_current_A`; call this while the current flows to confirm it.

        Raises:
            DeviceFault: The current differs from the one that was set, the voltage limit holds it back, or the coil is too hot by its
                thermometer or by the current that it has carried; the rig is brought to rest.
        """
        with self._interlock.guard(self._name):
            reading = self._read(timeout_s)
            if self._requested_A is not None and not self._delivers(self._requested_A, reading):
                is_held_back = ReadingFlag.OVER_RANGE in reading.flags
                reason = (
                    "its voltage limit holds it back"
                    if is_held_back
                    else "it has switched itself off or is limited"
                )
                raise DeviceFault(
                    f"{self._name} delivers {reading.value:.4g} A where {self._requested_A:g} A were set: {reason}"
                )
            return reading

    def check_coil(self) -> None:
        """Trip if the coil is too hot, by its thermometer or by the current set, or if the thermometer fails; sends the source nothing."""
        with self._interlock.guard(self._name):
            self._check_temperature()
            self._check_duty(self._flowing_A)

    def begin_with(self, load: CoilLoad) -> None:
        """Start from the load that earlier runs have left on the coil.

        Args:
            load: Load as of now, on any clock; a coil of unknown history is taken to be cold.
        """
        with self._load_lock:
            self._load = CoilLoad(time.monotonic(), load.mean_square_A2)

    def output_off(self, *, timeout_s: float) -> None:
        """See `CurrentSource.output_off`; allowed at any time."""
        self._requested_A = None
        self._source.output_off(timeout_s=timeout_s)
        self._update_load(self._flowing_A)
        self._flowing_A = 0.0

    def close(self) -> None:
        """See `Device.close`."""
        self._source.close()

    def _read(self, timeout_s: float) -> Reading[float]:
        self._check_temperature()
        reading = self._source.read_current_A(timeout_s=timeout_s)
        self._check_duty(reading.value)
        return reading

    def _check_duty(self, flowing_A: float) -> None:
        load = self._update_load(flowing_A)
        continuous_A = self._limits.continuous_A
        if load.mean_square_A2 > continuous_A**2 and abs(flowing_A) > continuous_A:
            raise DeviceFault(
                f"{self._name} must cool: it has carried more than {continuous_A:g} A for too long"
            )

    def _check_temperature(self) -> None:
        if self._read_temperature_K is not None:
            check_temperature(self._read_temperature_K(), self._limits)

    def _wait_for(self, current_A: float, deadline: Deadline) -> None:
        while True:
            reading = self._read(max(deadline.remaining_s, _POLL_S))
            if self._delivers(current_A, reading):
                return
            if deadline.is_over:
                raise DeviceFault(
                    f"{self._name} must carry {current_A:g} A within {deadline.allowed_s:.3g} s; it measures {reading.value:.4g} A"
                    f"{', held back by its voltage limit' if ReadingFlag.OVER_RANGE in reading.flags else ''}"
                )
            time.sleep(min(_POLL_S, deadline.remaining_s))

    def _delivers(self, current_A: float, reading: Reading[float]) -> bool:
        """Whether a current flows and is regulated: at the voltage limit it would drift with the coil's temperature."""
        is_held_back = ReadingFlag.OVER_RANGE in reading.flags
        return abs(reading.value - current_A) <= self._tolerance_A and not is_held_back

    def _update_load(self, current_A: float) -> CoilLoad:
        """The load now, if `current_A` has flowed since the last update."""
        with self._load_lock:
            self._load = self._load.after(current_A, time.monotonic(), self._limits)
            self._flowing_A = current_A
            return self._load


class GuardedArm(ClosesItself):
    """A `RobotArm` within its workspace; any fault of the arm brings the rig to rest."""

    def __init__(self, arm: RobotArm, limits: ArmLimits, interlock: Interlock, *, name: str) -> None:
        self._arm, self._limits, self._interlock, self._name = arm, limits, interlock, name
        interlock.add(name, lambda: arm.stop(timeout_s=_STOP_S))
        interlock.add_condition(name, arm.require_safe)

    def identify(self, *, timeout_s: float) -> str:
        """See `Device.identify`."""
        return self._arm.identify(timeout_s=timeout_s)

    def read_pose(self, *, timeout_s: float) -> Reading[FlangePose]:
        """See `RobotArm.read_pose`."""
        with self._interlock.guard(self._name):
            return self._arm.read_pose(timeout_s=timeout_s)

    def require_safe(self) -> None:
        """See `RobotArm.require_safe`; trips if the arm is not safe."""
        self._interlock.check_conditions()

    def move_to(self, base_from_flange: FlangePose, *, speed_m_per_s: float, timeout_s: float) -> None:
        """See `RobotArm.move_to`.

        Raises:
            Refused: The motion is beyond a limit, or the rig has tripped; nothing was sent.
        """
        deadline = Deadline.after(timeout_s)
        with self._interlock.guard(self._name):
            start = self._arm.read_pose(timeout_s=deadline.remaining_s).value
            check_motion(start, base_from_flange, speed_m_per_s, self._limits)
            self._arm.move_to(base_from_flange, speed_m_per_s=speed_m_per_s, timeout_s=deadline.remaining_s)

    def stop(self, *, timeout_s: float) -> None:
        """See `RobotArm.stop`; allowed at any time."""
        self._arm.stop(timeout_s=timeout_s)

    def close(self) -> None:
        """See `Device.close`."""
        self._arm.close()


class GuardedSensor(ClosesItself):
    """A `FieldSensor` whose faults bring the rig to rest: no coil is heated while nothing is measured."""

    def __init__(self, sensor: FieldSensor, interlock: Interlock, *, name: str) -> None:
        self._sensor, self._interlock, self._name = sensor, interlock, name

    def identify(self, *, timeout_s: float) -> str:
        """See `Device.identify`."""
        return self._sensor.identify(timeout_s=timeout_s)

    def read_field_T(self, *, timeout_s: float) -> Reading[Vector]:
        """See `FieldSensor.read_field_T`."""
        with self._interlock.guard(self._name):
            return self._sensor.read_field_T(timeout_s=timeout_s)

    def read_new_T(self, *, timeout_s: float) -> list[Reading[Vector]]:
        """See `FieldSensor.read_new_T`."""
        with self._interlock.guard(self._name):
            return self._sensor.read_new_T(timeout_s=timeout_s)

    def close(self) -> None:
        """See `Device.close`."""
        self._sensor.close()


class GuardedThermometer:
    """A `Thermometer` whose faults bring the rig to rest: a coil of unknown temperature may be burning."""

    def __init__(self, thermometer: Thermometer, interlock: Interlock, *, name: str) -> None:
        self._thermometer, self._interlock, self._name = thermometer, interlock, name

    def read_temperature_K(self, *, timeout_s: float) -> Reading[float]:
        """See `Thermometer.read_temperature_K`."""
        with self._interlock.guard(self._name):
            return self._thermometer.read_temperature_K(timeout_s=timeout_s)
