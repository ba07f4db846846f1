"""Moves a Universal Robots arm through ur_rtde; runs only in a child process (`drivers.supervised`).

Measurements of ur_rtde 1.6.5 shape this file. Its constructors hold the interpreter lock. A dropped connection crashes it while it
reconnects, and it may then send its last command again. `False` means that something went wrong, not that the arm stands still.
A stalled network goes unnoticed for 2.5 s. So all moves are asynchronous; one loop kicks the controller's watchdog and watches the
motion through its own RTDE stream; and a lost connection ends the process.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

from drivers.children import run_ahead
from drivers.deadline import Deadline
from drivers.errors import DeviceFault, DriverError, Refused
from drivers.protocols import FlangePose
from drivers.robots import rtde
from drivers.robots.rtde_reader import RtdeReader, Sample
from drivers.robots.safety_bits import NOT_RUNNING, why_not_running, why_stopped
from drivers.rotation import angle_between_rad, interpolate
from drivers.serving import end_at_once
from drivers.transport.tcp import TcpPort

_LOG = logging.getLogger(__name__)

WATCHDOG_HZ = 5.0
"""The controller stops the program when no kick came for 0.2 s; the arm then moved 3 mm further after its client was killed."""

NAMES = ("actual_TCP_pose", "actual_TCP_speed", "actual_q", "safety_status_bits", "runtime_state")

_PAUSE_S = (
    0.75 / WATCHDOG_HZ
)  # a longer silence of this process may be what made the watchdog stop the program
_OLDEST_S = 0.3  # longer than the pauses of a busy computer; if the connection is dead, the arm's own watchdog is faster
_OLD_S = 0.2  # time in which what waited at the door of this process during a pause has been taken
_UPLOADS = 3  # attempts to start the control script: on a busy computer the watchdog may stop it at once
_SCRIPT_S = 5.0
_LOOP_S = 0.01
# Fractions of a motion that are checked besides its end; each costs two questions, 10 ms on a UR3e and 40 ms on a UR3.
_CHECKED_SHARES = (0.25, 0.5, 0.75)
_ACCELERATION_M_PER_S2 = 0.25
_BRAKE_M_PER_S2 = 2.0
_STILL_M_PER_S, _STILL_RAD_PER_S = 1e-3, 5e-3
_ARRIVED_M, _ARRIVED_RAD = 5e-4, 2e-3
_CONNECT_S = 3.0
_TCP_OFFSET_M = 1e-6


class ProgramEnded(DeviceFault):
    """The control script does not run any more, and no safety stop is the reason: a watchdog, or somebody at the pendant."""


class UrMotion:
    """Motion of one arm; the device of a supervised child (`KeptAlive`)."""

    _contact_s = math.inf
    """When the controller heard of this process last."""
    _had_pause = False
    """Whether it did not for nearly as long as its watchdog waits, since its program was started."""
    _is_under_way = False

    def __init__(
        self,
        host: str,
        frequency_Hz: float,
        joint_limits_rad: Sequence[tuple[float, float]],
        interrupt: threading.Event,
    ) -> None:
        """Connect and upload the control script; nothing moves.

        Args:
            host: Address of the controller.
            frequency_Hz: 125 for a UR3, 500 for a UR3e.
            joint_limits_rad: Lowest and highest angle of each joint.
            interrupt: Set when the current motion should end.
        """
        run_ahead()  # before ur_rtde starts its threads, which inherit it
        import rtde_control  # type: ignore[import-not-found]  # compiled, without types

        self.is_lost = False
        self._interrupt, self._joint_limits_rad = interrupt, tuple(joint_limits_rad)
        port = TcpPort(host, rtde.PORT, timeout_s=_CONNECT_S)
        # ur_rtde would reconnect by itself, upload its script without the watchdog, and perhaps repeat the last motion.
        self._reader = RtdeReader(port, NAMES, frequency_Hz, timeout_s=_CONNECT_S, on_loss=end_at_once)
        self._name = f"arm at {host}"
        self._control: Any = self._connected(lambda: rtde_control.RTDEControlInterface(host, frequency_Hz))
        if not self._control.setWatchdog(WATCHDOG_HZ) and not any(self._upload() for _ in range(_UPLOADS)):
            raise DeviceFault(f"{self._name} must accept a watchdog; it did not")
        offset = self._control.getTCPOffset()
        if len(offset) != 6:
            self._require_obedience()
            offset = self._control.getTCPOffset()
        if len(offset) != 6:
            raise self._fault("does not say where its tool centre point is")
        if math.dist(offset, (0.0,) * 6) > _TCP_OFFSET_M:
            raise DeviceFault(
                f"{self._name} must have its tool centre point at the flange, because poses are those of the flange; it is at {offset}: "
                "set it to zero in the installation at the pendant"
            )

    def keep_alive(self) -> None:
        """See `KeptAlive.keep_alive`; the next motion finds out whether the arm obeys."""
        self._note_contact()
        if self._control.isConnected():
            self._control.kickWatchdog()

    def move_to(self, base_from_flange: FlangePose, *, speed_m_per_s: float, timeout_s: float) -> None:
        """See `RobotArm.move_to`.

        On a busy computer this process may have no time for longer than the watchdog of the controller waits. What that stopped is begun
        again from where the arm stands, within `timeout_s`. A program that ended in mid motion for another reason is a fault.

        Raises:
            Refused: The pose, or one of a few on the way, is beyond the safety limits of the controller or the given joint limits; nothing
                was sent.
            DeviceFault: The arm does not obey or was interrupted; the text says which, and whether it stands still.
        """
        deadline = Deadline.after(timeout_s)
        n_attempts = 0
        while True:
            n_attempts += 1
            self._is_under_way = False
            try:
                self._require_obedience()
                self._check_way(base_from_flange)
                self._go_straight(base_from_flange, speed_m_per_s, deadline)
                return
            except ProgramEnded as end:
                may_repeat = self._had_pause or (not self._is_under_way and n_attempts < _UPLOADS)
                if not may_repeat or self._interrupt.is_set() or deadline.is_over:
                    raise
                _LOG.warning("%s; this computer gave it no time, so it goes on", end)
                self._wait_until_still(deadline, has_program=False)

    def _check_way(self, target: FlangePose) -> None:
        start = pose_of(self._fresh_sample())
        for share in _CHECKED_SHARES:
            self._check_reach(numbers_of(interpolate(start, target, share)))
        self._check_reach(numbers_of(target))

    def _go_straight(self, target: FlangePose, speed_m_per_s: float, deadline: Deadline) -> None:
        before = self._control.getAsyncOperationProgressEx().operationId()
        self._note_contact()
        self._is_under_way = True
        if not self._control.moveL(numbers_of(target), speed_m_per_s, _ACCELERATION_M_PER_S2, True):
            self._note_contact()
            self._require_program()
            raise self._fault("refused the motion, so whether it moves is unknown")
        while True:
            self._watch(deadline)
            status = self._control.getAsyncOperationProgressEx()
            if status.operationId() != before and not status.isAsyncOperationRunning():
                break
        self._wait_until_still(deadline)
        self._check_arrival(target)

    def stop(self, *, timeout_s: float) -> None:
        """See `RobotArm.stop`."""
        deadline = Deadline.after(timeout_s)
        sample = self._reader.latest(at_most_s=_OLDEST_S)
        if why_not_running(sample.values) is None:
            self._control.stopL(_BRAKE_M_PER_S2)
        self._wait_until_still(deadline)

    def close(self) -> None:
        """Stop, end the control script and release the controller."""
        try:
            if not self.is_lost:
                self.stop(timeout_s=2.0)
                if why_not_running(self._fresh_sample().values) is None:
                    self._control.stopScript()
        finally:
            self._reader.close()
            self._control.disconnect()

    def _connected(self, connect: Callable[[], Any]) -> Any:
        """The client of ur_rtde, once its control script runs; where it does not, the fault says by what the arm is held."""
        for n_left in reversed(range(_UPLOADS)):
            try:
                return connect()
            except RuntimeError as error:
                reason = why_stopped(self._next_sample().values)
                if reason is not None or n_left == 0:
                    raise DeviceFault(
                        f"{self._name} must start its control script; {reason or error}"
                    ) from error
        raise AssertionError

    def _require_obedience(self) -> None:
        reason = why_not_running(self._fresh_sample().values)
        if reason == NOT_RUNNING:
            # A protective stop that was unlocked, or a pause of the host longer than the watchdog's.
            if not any(self._upload() for _ in range(_UPLOADS)):
                raise self._fault("does not start the control script again")
            reason = why_not_running(self._next_sample().values)
        if reason is not None:
            raise DeviceFault(f"{self._name} must obey; {reason}")

    def _upload(self) -> bool:
        """Start the control script, and wait until it runs: ur_rtde returns before that, but takes no command."""
        self._had_pause, self._contact_s = False, time.monotonic()
        if not self._control.reuploadScript():
            return False
        deadline = Deadline.after(_SCRIPT_S)
        while why_not_running(self._next_sample().values) or not self._control.isProgramRunning():
            if deadline.is_over:
                return False
        has_watchdog = bool(self._control.setWatchdog(WATCHDOG_HZ))
        self._contact_s = time.monotonic()
        return has_watchdog

    def _check_reach(self, pose: list[float]) -> None:
        self._note_contact()
        is_within = self._control.isPoseWithinSafetyLimits(pose)
        self._note_contact()
        if not is_within:
            self._require_program()
            raise Refused(f"arm.pose must be within the safety limits of the controller; received {pose}")
        joints_rad = self._control.getInverseKinematics(pose)
        self._note_contact()
        if len(joints_rad) != len(self._joint_limits_rad):
            self._require_program()
            raise self._fault("does not say which joints the pose needs")
        for index, (joint_rad, (low_rad, high_rad)) in enumerate(
            zip(joints_rad, self._joint_limits_rad, strict=True)
        ):
            if not low_rad <= joint_rad <= high_rad:
                raise Refused(
                    f"arm.joint_{index + 1}_rad must be within {low_rad:g} and {high_rad:g} on the way; "
                    f"{joint_rad:.3f} is needed for {pose}"
                )

    def _watch(self, deadline: Deadline) -> None:
        """One iteration of the loop during a motion; any fault ends the motion and is raised."""
        self._kick()
        self._require_program(self._fresh_sample())
        if self._interrupt.is_set():
            self._brake()
            raise DeviceFault(f"{self._name} must finish its motion; it was interrupted and stands still")
        if deadline.is_over:
            self._brake()
            raise deadline.exceeded(f"{self._name} must arrive", "it was stopped on the way and stands still")
        time.sleep(_LOOP_S)

    def _brake(self) -> None:
        self._control.stopL(_BRAKE_M_PER_S2)
        self._wait_until_still(Deadline.after(2.0))

    def _wait_until_still(self, deadline: Deadline, *, has_program: bool = True) -> None:
        while not is_still(self._fresh_sample()):
            if deadline.is_over:
                raise deadline.exceeded(f"{self._name} must stand still", "it still moves")
            if has_program:
                self._kick()
            time.sleep(_LOOP_S)

    def _check_arrival(self, target: FlangePose) -> None:
        sample = self._fresh_sample()
        self._require_program(sample)
        pose = pose_of(sample)
        off_m = math.dist(pose.position_m, target.position_m)
        off_rad = angle_between_rad(pose.rotation_vector_rad, target.rotation_vector_rad)
        if off_m > _ARRIVED_M or off_rad > _ARRIVED_RAD:
            raise DeviceFault(
                f"{self._name} must arrive within {1e3 * _ARRIVED_M:g} mm and {1e3 * _ARRIVED_RAD:g} mrad; "
                f"it stands {1e3 * off_m:.2f} mm and {1e3 * off_rad:.1f} mrad off"
            )

    def _fresh_sample(self) -> Sample:
        return self._sample(lambda: self._reader.latest(at_most_s=_OLDEST_S))

    def _next_sample(self) -> Sample:
        return self._sample(lambda: self._reader.read_after(time.monotonic(), timeout_s=_OLDEST_S))

    def _sample(self, read: Callable[[], Sample]) -> Sample:
        try:
            return read()
        except DriverError as error:
            self.is_lost = True
            raise DeviceFault(
                f"{self._name} must be heard; {error}; its watchdog stops it within {1 / WATCHDOG_HZ:g} s, which is not confirmed"
            ) from error

    def _kick(self) -> None:
        """Kick the controller's watchdog."""
        self._note_contact()
        if self._control.isConnected() and self._control.kickWatchdog():
            return
        # The kick is refused once the program has ended; the next package says why.
        self._require_program()
        self.is_lost = True
        raise self._fault(
            "does not accept kicks of its watchdog, so the watchdog stops it, which is not confirmed"
        )

    def _note_contact(self) -> None:
        """Note that the controller hears of this process now, and whether it did not for nearly as long as its watchdog waits."""
        now_s = time.monotonic()
        self._had_pause = self._had_pause or now_s - self._contact_s > _PAUSE_S
        self._contact_s = now_s

    def _require_program(self, sample: Sample | None = None) -> None:
        """Raise if the arm does not obey any more; an answer that came from no program means nothing.

        Args:
            sample: Sample to look at; by default those that come now. After a pause of this process, the first may be old.
        """
        self._note_contact()
        look = Deadline.after(0.0 if sample else _OLD_S)
        reason = why_not_running((sample or self._next_sample()).values)
        while reason is None and not look.is_over:
            self.keep_alive()
            time.sleep(_LOOP_S)
            reason = why_not_running(self._next_sample().values)
        if reason is not None:
            kind = ProgramEnded if reason == NOT_RUNNING else DeviceFault
            raise kind(f"{self._name} must finish its motion; {reason}")

    def _fault(self, what: str) -> DeviceFault:
        return DeviceFault(f"{self._name} {what}")


def numbers_of(pose: FlangePose) -> list[float]:
    """A pose in the notation of ur_rtde."""
    return [*pose.position_m, *pose.rotation_vector_rad]


def pose_of(sample: Sample) -> FlangePose:
    """Pose of the flange in a sample; the tool centre point is at the flange."""
    numbers = sample.values["actual_TCP_pose"]
    assert isinstance(numbers, tuple)
    x_m, y_m, z_m, x_rad, y_rad, z_rad = numbers
    return FlangePose((x_m, y_m, z_m), (x_rad, y_rad, z_rad))


def is_still(sample: Sample) -> bool:
    """Whether the flange neither moves nor turns."""
    speed = sample.values["actual_TCP_speed"]
    assert isinstance(speed, tuple)
    return math.hypot(*speed[:3]) <= _STILL_M_PER_S and math.hypot(*speed[3:]) <= _STILL_RAD_PER_S
