"""Arms of Universal Robots as a `RobotArm`: poses from a lossless RTDE reader, motion in a supervised child process.

Poses are those of the flange only if the tool centre point set at the pendant is zero; the first motion checks that. A real
arm must be in remote control (UR3e). If the child is killed, the watchdog of the controller stops the arm after 0.2 s.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Sequence
from functools import partial

from drivers.deadline import Deadline
from drivers.device import ClosesItself
from drivers.errors import DeadlineExceeded, DeviceFault, DriverError, Refused
from drivers.protocols import FlangePose, Reading, ReadingFlag
from drivers.readings import ReadingCounter, ascii_text
from drivers.robots import rtde
from drivers.robots.rtde_reader import RtdeReader, Sample
from drivers.robots.safety_bits import why_stopped
from drivers.robots.ur_motion import NAMES, UrMotion, is_still, pose_of
from drivers.supervised import LONGEST_START_S, Supervised
from drivers.transport.channel import Channel
from drivers.transport.tcp import TcpPort

_LOG = logging.getLogger(__name__)

DASHBOARD_PORT = 29999
FREQUENCY_HZ = {
    **dict.fromkeys(("UR3", "UR5", "UR10"), 125.0),  # CB3
    **dict.fromkeys(("UR3e", "UR5e", "UR10e", "UR16e", "UR20"), 500.0),
}
JOINT_LIMITS_RAD = ((-2 * math.pi, 2 * math.pi),) * 6
"""Range of the joints (of a UR3, the last one turns without end); a rig with cables states narrower limits."""

_CLOSE_S = 10.0
_STILL_S = 2.0
_CONNECT_S = 3.0
_OLDEST_S = 2.0  # for an arm at rest; during a motion the child is stricter


class UniversalRobot(ClosesItself):
    """One arm. The child process starts with the first motion; reading needs none."""

    def __init__(
        self,
        host: str,
        model: str,
        *,
        joint_limits_rad: Sequence[tuple[float, float]] = JOINT_LIMITS_RAD,
        longest_start_s: float = LONGEST_START_S,
    ) -> None:
        """Connect to the RTDE port; nothing moves, no program is started.

        Args:
            host: Address of the controller.
            model: One of `FREQUENCY_HZ`; sets the rate of the control cycle.
            joint_limits_rad: Lowest and highest angle of each of the six joints.
            longest_start_s: Time for the child that the first motion starts; it does not count as time of the motion.

        Raises:
            DriverError: The controller is not there.
        """
        if len(joint_limits_rad) != 6:
            raise Refused(f"arm.joint_limits_rad must be six pairs; received {len(joint_limits_rad)}")
        self._host, self._frequency_Hz, self._longest_start_s = host, FREQUENCY_HZ[model], longest_start_s
        self._name = f"{model} at {host}"
        self._make = partial(UrMotion, host, self._frequency_Hz, tuple(joint_limits_rad))
        self._reader = self._connect()
        self._motion: Supervised | None = None
        self._counter = ReadingCounter()
        self._last_device_time_s = -math.inf
        self._is_closed = False

    @property
    def motion_pid(self) -> int | None:
        """Process id of the child; None before the first motion."""
        return self._motion.pid if self._motion else None

    def identify(self, *, timeout_s: float) -> str:
        """See `Device.identify`; from the dashboard."""
        deadline = Deadline.after(timeout_s)
        model, serial_number, version = self._dashboard(
            ("get robot model", "get serial number", "PolyscopeVersion"), deadline
        )
        return f"Universal Robots, {model}, {serial_number}, {version}"

    def read_pose(self, *, timeout_s: float) -> Reading[FlangePose]:
        """See `RobotArm.read_pose`; the first package that arrives after the call."""
        sample = self._connected_reader().read_after(time.monotonic(), timeout_s=timeout_s)
        return self._reading(sample)

    def require_safe(self) -> None:
        """See `RobotArm.require_safe`; from the newest package, which stays in the queue."""
        sample = self._reader.latest(at_most_s=_OLDEST_S)
        if reason := why_stopped(sample.values):
            raise DeviceFault(f"{self._name} must be free to move; {reason}")

    def move_to(self, base_from_flange: FlangePose, *, speed_m_per_s: float, timeout_s: float) -> None:
        """See `RobotArm.move_to`; a fault says whether the arm is known to stand still. No command is ever sent twice."""
        try:
            if self._motion is None or self._motion.has_ended:
                name = f"motion of {self._name}"
                self._motion = Supervised(self._make, name, longest_start_s=self._longest_start_s)
            self._motion.call(
                "move_to", base_from_flange=base_from_flange, speed_m_per_s=speed_m_per_s, timeout_s=timeout_s
            )
        except Refused:
            raise
        except DriverError as error:
            raise type(error)(f"{error}; {self._standing()}") from error

    def stop(self, *, timeout_s: float) -> None:
        """See `RobotArm.stop`; if the child is gone or does not answer, the program is stopped through the dashboard."""
        deadline = Deadline.after(timeout_s)
        try:
            if self._motion is not None and not self._motion.has_ended:
                self._motion.call("stop", timeout_s=deadline.remaining_s / 2, is_urgent=True)
        except DriverError as error:
            # A living child would go on kicking the watchdog and keep the controller's inputs from its successor.
            _LOG.warning("stopping by the watchdog and the dashboard because the child failed: %s", error)
            if self._motion is not None:
                self._motion.kill()
            self._motion = None
        if self._motion is None or self._motion.has_ended:
            self._dashboard(("stop",), deadline)
        self._wait_until_still(deadline)

    def close(self) -> None:
        """See `Device.close`."""
        if self._is_closed:
            return
        self._is_closed = True
        try:
            if self._motion is not None and not self._motion.has_ended:
                self._motion.close(timeout_s=_CLOSE_S)
                self._wait_until_still(Deadline.after(_STILL_S))
        finally:
            self._reader.close()

    def _connect(self) -> RtdeReader:
        port = TcpPort(self._host, rtde.PORT, timeout_s=_CONNECT_S)
        return RtdeReader(port, NAMES, self._frequency_Hz, timeout_s=_CONNECT_S)

    def _connected_reader(self) -> RtdeReader:
        """The reader, replaced if its connection was lost; that sends nothing to the arm."""
        if self._reader.is_lost:
            self._reader.close()
            self._reader = self._connect()
            self._counter.note_loss()
        return self._reader

    def _reading(self, sample: Sample) -> Reading[FlangePose]:
        if sample.is_after_loss:
            self._counter.note_loss()
        is_new = sample.device_time_s > self._last_device_time_s
        self._last_device_time_s = sample.device_time_s
        return self._counter.reading(
            pose_of(sample),
            ReadingFlag.NONE if is_new else ReadingFlag.STALE,
            host_monotonic_s=sample.host_monotonic_s,
            device_time_s=sample.device_time_s,
        )

    def _standing(self) -> str:
        """Whether the arm stands still, for the end of a sentence."""
        deadline = Deadline.after(_STILL_S)
        try:
            if self._motion is None or self._motion.has_ended:
                self._dashboard(("stop",), deadline)
            self._wait_until_still(deadline)
        except DriverError:
            return "whether the arm stands still is unknown"
        return "the arm stands still"

    def _wait_until_still(self, deadline: Deadline) -> None:
        reader = self._connected_reader()
        while True:
            sample = reader.read_after(time.monotonic(), timeout_s=max(0.1, deadline.remaining_s))
            if is_still(sample):
                return
            if deadline.is_over:
                raise DeadlineExceeded(
                    f"{self._name} must stand still within {deadline.allowed_s:g} s; it still moves"
                )

    def _dashboard(self, lines: Sequence[str], deadline: Deadline) -> list[str]:
        """Answers of the dashboard, one for each line."""
        port = TcpPort(self._host, DASHBOARD_PORT, timeout_s=max(0.1, deadline.remaining_s))
        channel = Channel(port)
        try:
            with channel.exchange(deadline):
                channel.read_until(b"\n", deadline)  # its banner
                return [
                    ascii_text(channel.query(f"{line}\n".encode("ascii"), b"\n", deadline)).strip()
                    for line in lines
                ]
        except DeviceFault as error:
            raise DeviceFault(f"{self._name} must answer on its dashboard; {error}") from error
        finally:
            channel.close()
