"""Turns the commands of a supply into a current source, which changes the current in small steps and reads each one back."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable

from drivers.deadline import Deadline
from drivers.device import ClosesItself
from drivers.errors import DeadlineExceeded, DeviceFault, DriverError, Refused
from drivers.protocols import Reading, ReadingFlag
from drivers.readings import ReadingCounter
from drivers.supplies.commands import SupplyCommands

_LOG = logging.getLogger(__name__)

_COMMANDS_S = 5.0
_ANSWER_S = 1.0
"""Time in which a supply must say whether its output is off, before it is told once more."""
_CUT_S = 0.5
"""Time between the last step of a ramp to zero and the deadline of switching off."""
_PAUSE_S = 0.5
"""Time between two attempts to switch off a supply that does not confirm it."""
_ROUNDS = 4
"""Attempts on one connection before a new one is tried: a network instrument may go on only there."""
_SIGNS = 4
"""Questions that the watchdog of a supply hears in the time after which it would switch off."""
_SILENCE = 1.5
"""Silence for the watchdog of a supply that does not confirm that it is off, in times of its delay."""
INSIST_S = 600.0
"""How long a process whose program has gone on without it still tries to switch off a supply that does not confirm it."""
_SLOWNESS = 2.0
"""A ramp on a busy computer may take this many times as long as planned before it is cut short."""


def longest_off_s(largest_A: float, slew_A_per_s: float) -> float:
    """Time to allow for a ramp to zero and for switching off.

    Args:
        largest_A: Largest possible absolute current.
        slew_A_per_s: Rate of the ramp.

    Examples:
        >>> longest_off_s(3.0, 0.4)
        20.0
    """
    return _COMMANDS_S + _SLOWNESS * largest_A / slew_A_per_s


def ramp_steps(start_A: float, target_A: float, slew_A_per_s: float, step_s: float) -> list[float]:
    """Set-points of a ramp, from the first step to the target.

    Args:
        start_A: Current at the start, which is not among the set-points.
        target_A: Current at the end.
        slew_A_per_s: Highest rate of change.
        step_s: Time between two set-points.

    Examples:
        >>> ramp_steps(0.0, 1.0, 4.0, 0.1)
        [0.333, 0.667, 1.0]
        >>> ramp_steps(1.0, 1.0, 4.0, 0.1)
        [1.0]
    """
    n_steps = max(1, math.ceil(abs(target_A - start_A) / (slew_A_per_s * step_s) - 1e-9))
    return [start_A + (target_A - start_A) * step / n_steps for step in range(1, n_steps)] + [target_A]


class RampedSource(ClosesItself):
    """A `CurrentSource` that never changes its set-point faster than the coil allows.

    If the present current is unknown, as at the start and after a fault, the supply is asked for it. Switching off asks nothing, for the
    supply may be mute: an unknown current becomes zero at once, which the voltage limit of the supply turns into a ramp.
    """

    def __init__(
        self,
        supply: SupplyCommands,
        *,
        slew_A_per_s: float,
        interrupt: threading.Event | None = None,
        reopen: Callable[[], SupplyCommands] | None = None,
    ) -> None:
        """Wrap the commands of a supply; nothing is sent before the first call.

        Args:
            supply: Commands of the model.
            slew_A_per_s: Highest rate of change: voltage limit of the supply over inductance of the coil, U / L.
            interrupt: Set by another thread to end a ramp of `set_current_A` early, as `output_off` does by itself.
            reopen: Opens the supply on a new connection, once the old one is lost or its supply mute; None where that is impossible.
        """
        if not slew_A_per_s > 0:
            raise Refused(f"source.slew_A_per_s must be > 0; received {slew_A_per_s}")
        self.name = supply.name
        self._supply, self._reopen, self.slew_A_per_s = supply, reopen, slew_A_per_s
        self.longest_off_s = longest_off_s(max(-supply.lowest_A, supply.highest_A), slew_A_per_s)
        self._interrupt = interrupt or threading.Event()
        self._is_switching_off = threading.Event()
        self._lock = threading.RLock()
        self._set_point_A: float | None = None
        self._was_told = False
        self._sign_due_s = 0.0
        self._is_closed = False
        self._counter = ReadingCounter()

    def identify(self, *, timeout_s: float) -> str:
        """See `Device.identify`."""
        return self._supply.identify(Deadline.after(timeout_s))

    def set_current_A(self, current_A: float, *, timeout_s: float) -> None:
        """See `CurrentSource.set_current_A`.

        Raises:
            Refused: The supply cannot deliver it, or the ramp would take longer than `timeout_s`; nothing was sent.
        """
        deadline = Deadline.after(timeout_s)
        supply = self._supply
        if not supply.lowest_A <= current_A <= supply.highest_A:
            raise Refused(
                f"source.current_A must be within {supply.lowest_A:g} and {supply.highest_A:g}; received {current_A:g} ({self.name})"
            )
        if not self._lock.acquire(timeout=deadline.remaining_s):
            raise deadline.exceeded(f"{self.name} must be free", "a ramp of another thread goes on")
        try:
            self._ramp(current_A, deadline)
        finally:
            self._lock.release()

    def read_current_A(self, *, timeout_s: float) -> Reading[float]:
        """See `CurrentSource.read_current_A`; flagged `OVER_RANGE` if the voltage limit holds the current back."""
        measured = self._supply.measure(Deadline.after(timeout_s))
        return self._counter.reading(
            measured.current_A, ReadingFlag.NONE if measured.is_regulating else ReadingFlag.OVER_RANGE
        )

    def output_off(self, *, timeout_s: float) -> None:
        """See `CurrentSource.output_off`; nothing is read before the output is off, and it is told again until it confirms that.

        Raises:
            DriverError: The output is not known to be off. The last attempt may end 2 s after `timeout_s`.
        """
        deadline, self._was_told = Deadline.after(timeout_s), True
        self._is_switching_off.set()  # the ramp of another thread ends at its next step
        # A thread that waits for a mute supply holds the lock; it is not waited for longer than an answer takes.
        has_lock = self._lock.acquire(timeout=deadline.at_most(_ANSWER_S).remaining_s)
        try:
            self._switch_off(deadline)
        finally:
            self._is_switching_off.clear()
            if has_lock:
                self._lock.release()

    def close(self) -> None:
        """See `Device.close`."""
        if self._is_closed:
            return
        self._is_closed = True
        try:
            self.come_to_rest()
        finally:
            self._supply.close()

    def come_to_rest(self) -> None:
        """See `drivers.serving.Insistent.come_to_rest`; a supply that was never told anything is left as it was."""
        if not self._was_told:
            return
        self.output_off(timeout_s=self.longest_off_s)
        try:
            self._supply.disarm(Deadline.after(_ANSWER_S))
        except DriverError as error:
            _LOG.warning("%s is off, and its watchdog stays on: %s", self.name, error)

    def insist(self) -> None:
        """See `drivers.serving.Insistent.insist`; for `INSIST_S`. The watchdog of the supply gets its silence first."""
        if self._supply.watchdog_s is not None:
            time.sleep(_SILENCE * self._supply.watchdog_s)
        self._cut(Deadline.after(INSIST_S))

    is_lost = False
    """See `drivers.serving.KeptAlive`; a supply is never given up."""

    def keep_alive(self) -> None:
        """See `drivers.serving.KeptAlive`; asks often enough for the watchdog of the supply, if it has one that was set."""
        watchdog_s = self._supply.watchdog_s
        if watchdog_s is None or not self._was_told or time.monotonic() < self._sign_due_s:
            return
        self._sign_due_s = time.monotonic() + watchdog_s / _SIGNS
        try:
            self._supply.is_output_on(Deadline.after(_ANSWER_S))
        except DriverError as error:
            _LOG.warning("%s gave no sign of life: %s", self.name, error)

    def _ramp(self, current_A: float, deadline: Deadline) -> None:
        start_A = self._prepared_set_point_A(deadline)
        needed_s = abs(current_A - start_A) / self.slew_A_per_s
        if needed_s > deadline.allowed_s:
            raise Refused(
                f"a ramp from {start_A:g} to {current_A:g} A must be allowed {needed_s:.1f} s; "
                f"received {deadline.allowed_s:g} s ({self.name})"
            )
        for step_A in ramp_steps(start_A, current_A, self.slew_A_per_s, self._supply.step_s):
            if self._interrupt.is_set() or self._is_switching_off.is_set():
                raise DeviceFault(
                    f"the ramp to {current_A:g} A must finish; it was interrupted at {self._set_point_A} A ({self.name})"
                )
            if step_A != start_A:
                self._write(step_A, deadline)

    def _switch_off(self, deadline: Deadline) -> None:
        """Ramp to zero and cut, and read nothing before that: a supply that no longer answers may still obey.

        A set-point that is not known, as on a new connection, becomes zero at once: no step of a ramp may raise the current.
        """
        start_A, self._set_point_A = self._set_point_A, None
        steps_A = [] if start_A is None else ramp_steps(start_A, 0.0, self.slew_A_per_s, self._supply.step_s)
        for step_A in steps_A[:-1]:
            next_step = Deadline.after(self._supply.step_s)
            if next_step.at_s > deadline.at_s - _CUT_S:
                _LOG.error("%s has no time for its ramp to zero and is switched off at once", self.name)
                break
            try:
                self._supply.send_set_point(step_A, next_step)
            except DriverError as error:
                _LOG.error("ramp to zero failed, switching off at once: %s", error)
                break
            next_step.sleep_out()
        self._cut(deadline)

    def _cut(self, deadline: Deadline) -> None:
        """Switch off without asking first, and again until the supply confirms it; at least once, even past the deadline.

        Raises:
            DriverError: It has not confirmed it.
        """
        n_attempts = 0
        while True:
            n_attempts += 1
            error: DriverError | None
            is_lost = False
            try:
                self._supply.cut(Deadline.after(_ANSWER_S))
            except DeadlineExceeded as fault:
                error = fault
            except DriverError as fault:
                error, is_lost = fault, True
            else:
                error = self._why_not_off()
            if error is None:
                return
            if deadline.is_over or (is_lost and self._reopen is None):
                raise error
            if self._reopen is not None and (is_lost or n_attempts % _ROUNDS == 0):
                self._renew(self._reopen)
            time.sleep(min(_PAUSE_S, deadline.remaining_s))

    def _why_not_off(self) -> DriverError | None:
        """Why the output is not known to be off; None if the supply says that it is."""
        try:
            is_on = self._supply.is_output_on(Deadline.after(_ANSWER_S))
        except DriverError as error:
            return error
        return (
            DeviceFault(f"source.output must be off; the supply says it is on ({self.name})")
            if is_on
            else None
        )

    def _renew(self, reopen: Callable[[], SupplyCommands]) -> None:
        """Change to a new connection; the old one stays closed if there is none, which the next attempt finds out."""
        self._supply.close()
        try:
            self._supply = reopen()
        except DriverError as error:
            _LOG.warning("no new connection to %s: %s", self.name, error)

    def _prepared_set_point_A(self, deadline: Deadline) -> float:
        """The present set-point, with the output on; an output that was off is switched on at zero."""
        supply, self._was_told = self._supply, True
        if self._set_point_A is None:
            supply.prepare(deadline)
            if supply.is_output_on(deadline):
                self._set_point_A = supply.read_set_point_A(deadline)
            else:
                self._write(0.0, deadline, is_step=False)
                supply.switch_output(True, deadline)
                if not supply.is_output_on(deadline):
                    self._set_point_A = None
                    raise DeviceFault(f"source.output must be on; the supply says it is off ({self.name})")
                self._set_point_A = 0.0
        return self._set_point_A

    def _write(self, current_A: float, deadline: Deadline, *, is_step: bool = True) -> None:
        """Write one set-point and read it back; in a ramp, the pause after it sets the rate."""
        next_step = Deadline.after(self._supply.step_s if is_step else 0.0)
        self._set_point_A = None
        self._supply.write_set_point(current_A, deadline)
        read_back_A = self._supply.read_set_point_A(deadline)
        if not abs(read_back_A - current_A) <= self._supply.resolution_A:
            raise DeviceFault(
                f"source.set_point_A must be {current_A:g}; the supply says {read_back_A:g} ({self.name})"
            )
        self._set_point_A = current_A
        if deadline.at_s < next_step.at_s:
            raise DeadlineExceeded(
                f"the ramp must end within {deadline.allowed_s:g} s; it is at {current_A:g} A ({self.name})"
            )
        next_step.sleep_out()
