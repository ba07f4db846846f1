"""Carries out single stops with the instruments: move, set currents, settle, read.

`estimator.acquisition.acquire` calls it once for each stop of a session. Instruments are used only through `drivers.protocols`.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from statistics import fmean
from typing import Any, Protocol, runtime_checkable

import torch
from torch import Tensor

from drivers import protocols
from drivers.errors import DeviceFault
from estimator.acquisition.averages import DeviceClock, average, measured
from estimator.acquisition.pace import ANSWER_S, Pace
from estimator.frames import Transform
from estimator.geometry.motion import flange_to_reach, motion_reached
from estimator.readings.observations import Observations
from estimator.rig.rig import Rig
from estimator.store.growing import StopReadings
from estimator.units import ICE_POINT_K

# Below the repeatability of the arms: an arm that differs by less since its last motion has not moved.
STILL_M, STILL_RAD = 2e-5, 1e-4


@runtime_checkable
class Instruments(Protocol):
    """Open instruments by the name of the coil, sensor or mover that they serve; a `drivers.open.DeviceSet` is one."""

    sensors: dict[str, protocols.FieldSensor]
    sources: dict[str, protocols.CurrentSource]
    arms: dict[str, protocols.RobotArm]
    thermometers: dict[str, protocols.Thermometer]


class Visit:
    """Carries out the stops of a run; remembers the last settings, so that no command is sent twice."""

    def __init__(
        self,
        rig: Rig,
        instruments: Instruments,
        pace: Pace,
        references: Mapping[str, Sequence[float]],
        session_from_host_s: float,
    ) -> None:
        """Begin a run.

        Args:
            rig: The rig whose coils, sensors and movers the instruments serve.
            instruments: Open instruments behind the limits of the rig.
            pace: Times, speeds and number of readings.
            references: Position and rotation vector of each mover's flange at zero displacement, in metres and radians.
            session_from_host_s: Time since the session began, less `time.monotonic()`.
        """
        self._rig, self._instruments, self._pace = rig, instruments, pace
        self._references = {name: _transform(pose) for name, pose in references.items()}
        self._session_from_host_s = session_from_host_s
        self._begin_s = time.monotonic()
        self._answer_s: dict[str, float] = {}
        self._motion: dict[str, Tensor] = {}
        self._pose_at_rest: dict[str, protocols.FlangePose] = {}
        self._clocks: dict[str, DeviceClock] = {}
        self._current_A: dict[str, float] = {}

    def go_to(self, stops: Observations, row: int) -> None:
        """Move the arms, set the currents, and wait until they have settled."""
        for mover in self._rig.movers:
            motion = stops.motion[mover.name][row]
            if mover.name not in self._motion or bool((motion != self._motion[mover.name]).any()):
                target = flange_to_reach(mover, motion[None], self._references[mover.name])
                self._move(mover.name, protocols.FlangePose(*target.to_pose()))
                self._motion[mover.name] = motion
        for i, coil in enumerate(self._rig.coils):
            current_A = float(stops.current_A[row, i])
            if coil.name in self._instruments.sources and self._current_A.get(coil.name) != current_A:
                ramp_s = (
                    abs(current_A - self._current_A.get(coil.name, 0.0)) / self._pace.slew_A_per_s[coil.name]
                )
                self._instruments.sources[coil.name].set_current_A(
                    current_A, timeout_s=2.0 * ramp_s + ANSWER_S
                )
                self._current_A[coil.name] = current_A
        time.sleep(self._pace.settle_s)

    def read(self, stops: Observations, row: int) -> StopReadings:
        """Average the field, then read the poses, the currents and the temperatures."""
        averages = {
            name: average(sensor, name, self._pace, partial(self._taken_s, name))
            for name, sensor in self._instruments.sensors.items()
        }
        motion = {}
        for mover in self._rig.movers:
            pose = self._pose(mover.name)
            base_from_flange = _transform([*pose.position_m, *pose.rotation_vector_rad])
            requested = stops.motion[mover.name][row][None]
            reached = motion_reached(mover, base_from_flange, self._references[mover.name], requested)
            motion[mover.name] = reached[0].tolist()
        currents = {name: self._measured_current(name) for name in self._instruments.sources}
        temperature_C = {
            name: measured(thermometer.read_temperature_K(timeout_s=ANSWER_S).value) - ICE_POINT_K
            for name, thermometer in self._instruments.thermometers.items()
        }
        begin_s, self._begin_s = self._begin_s, time.monotonic()
        shift_s = self._session_from_host_s
        return StopReadings(
            fmean(readings.taken_s for readings in averages.values()) + shift_s,
            stops.current_A[row].tolist(),
            motion,
            {name: readings.mean_T.tolist() for name, readings in averages.items()},
            bool(stops.is_validation[row]),
            int(stops.repeat[row]),
            {name: reading.value for name, reading in currents.items()},
            {name: readings.sd_T.tolist() for name, readings in averages.items()},
            self._pace.n_readings,
            all(readings.has_settled for readings in averages.values()),
            {name: clock.delay_s for name, clock in self._clocks.items()},
            temperature_C,
            {name: readings.n_gaps for name, readings in averages.items()},
            {name: reading.host_monotonic_s + shift_s for name, reading in currents.items()},
            begin_s + shift_s,
            self._begin_s + shift_s,
            self._answer_s | {name: readings.answer_s for name, readings in averages.items()},
        )

    def return_home(self) -> None:
        """Move the arms to zero displacement, where the next session expects them."""
        for name, reference in self._references.items():
            self._move(name, protocols.FlangePose(*reference.to_pose()))

    def _measured_current(self, name: str) -> protocols.Reading[float]:
        """Current that a supply measures, if the supply reports no fault (`drivers.guarded` compares it with the requested one).

        Raises:
            DeviceFault: The supply has reached a limit, or gives no new value.
        """
        requested_A = self._current_A.get(name, 0.0)
        with self._timed(name):
            reading = self._instruments.sources[name].read_current_A(timeout_s=ANSWER_S)
        # At zero current a supply's report of what it regulates means nothing.
        if protocols.ReadingFlag.OVER_RANGE in reading.flags and requested_A != 0.0:
            raise DeviceFault(
                f"{name} must carry {requested_A:g} A; its supply has reached a limit and measures {reading.value:.4g} A"
            )
        if protocols.ReadingFlag.STALE in reading.flags or math.isnan(measured(reading.value)):
            raise DeviceFault(f"{name} must carry {requested_A:g} A; its supply gives no new measurement")
        return reading

    def _pose(self, name: str) -> protocols.FlangePose:
        """Pose of an arm; the first one since its last motion is kept, so that encoder noise makes no new pose."""
        with self._timed(name):
            reading = self._instruments.arms[name].read_pose(timeout_s=ANSWER_S)
        pose = reading.value
        self._taken_s(name, reading)
        pose_before = self._pose_at_rest.get(name)
        if (
            pose_before is None
            or math.dist(pose.position_m, pose_before.position_m) > STILL_M
            or math.dist(pose.rotation_vector_rad, pose_before.rotation_vector_rad) > STILL_RAD
        ):
            self._pose_at_rest[name] = pose
        return self._pose_at_rest[name]

    def _move(self, name: str, target: protocols.FlangePose) -> None:
        arm, speed_m_per_s = self._instruments.arms[name], self._pace.speed_m_per_s[name]
        start = arm.read_pose(timeout_s=ANSWER_S).value
        distance_m = math.dist(start.position_m, target.position_m)
        # The 10 s are for a turn on the spot: half a turn at the slowest rate in use.
        timeout_s = 2.0 * distance_m / speed_m_per_s + 10.0 + ANSWER_S
        self._pose_at_rest.pop(name, None)
        arm.move_to(target, speed_m_per_s=speed_m_per_s, timeout_s=timeout_s)

    def _taken_s(self, name: str, reading: protocols.Reading[Any], asked_s: float = -math.inf) -> float:
        """When a reading was taken, on the host's clock: its arrival if the instrument has no clock, and never before the request."""
        if reading.device_time_s is None:
            return reading.host_monotonic_s
        clock = self._clocks.setdefault(name, DeviceClock())
        clock.add(reading.host_monotonic_s, reading.device_time_s, asked_s)
        return max(asked_s, clock.on_host_s(reading.device_time_s))

    @contextmanager
    def _timed(self, name: str) -> Iterator[None]:
        """Note how long an instrument takes to answer in the block."""
        asked_s = time.monotonic()
        yield
        self._answer_s[name] = time.monotonic() - asked_s


def _transform(pose: Sequence[float]) -> Transform:
    numbers = torch.tensor([list(pose)], dtype=torch.float64)
    return Transform.from_pose(numbers[:, :3], numbers[:, 3:])
