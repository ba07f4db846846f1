"""Runs a device in a child process (`drivers.serving`), which outlives its parent until the device is at rest.

The end of the parent, even by SIGKILL, closes the pipe between the two. The child sees that, ramps the current to zero or stops
the arm, and ends. A parent that is stopped (SIGSTOP, Ctrl-Z) is heard no more (`drivers.pulse`), with the same consequence; a child that is
stopped or hangs is noticed in the same way. And a library that crashes (ur_rtde does when its connection drops) takes the child with it,
not the measurement. If both processes or the whole computer stop, only the watchdogs of the instruments help.
"""

from __future__ import annotations

import atexit
import logging
import multiprocessing.process
import threading
from collections.abc import Callable
from typing import Any

from drivers.children import SPAWN, deaf_to_the_terminal, start_without_main
from drivers.deadline import Deadline
from drivers.errors import DeadlineExceeded, DeviceFault, DriverError
from drivers.pulse import BEAT_S, SILENT_S, Heart, Pulse, beat_for
from drivers.serving import GIVEN_UP, INTERRUPT, LEFT, LOST, MADE, STARTED, Answer, Call, serve

_LOG = logging.getLogger(__name__)

_GRACE_S = 0.5
"""Time that an answer may take beyond the deadline of its call; the child keeps the deadline itself."""
_KILLED_S = 10.0
"""Time that the end of a killed child may take on a busy computer."""
LONGEST_START_S = 60.0
"""Unless the settings say otherwise. A child that fails is heard of at once, so this is for one that a busy computer gives no time."""
LONGEST_REST_S = 10.0
"""Unless the settings say otherwise, time that a device may take to come to rest."""


class Unanswered(DeadlineExceeded):
    """No answer of the child, which keeps the deadlines of its device itself: it hangs."""


_REASONS = {
    LOST: "its connection to the device broke",
    LEFT: f"it heard nothing from this program for {SILENT_S:g} s (was it stopped?) and brought its device to rest",
}


class Supervised:
    """The parent's end: calls methods of a device in a child process."""

    def __init__(
        self,
        make: Callable[[threading.Event], Any],
        name: str,
        *,
        longest_start_s: float,
        longest_rest_s: float = LONGEST_REST_S,
    ) -> None:
        """Start the child and wait until its device is made.

        Args:
            make: Importable function that makes the device in the child. Its argument is set when the current call should end.
            name: Name of the device in messages.
            longest_start_s: Time for starting the child and making the device.
            longest_rest_s: Time to wait, when this program ends, for the child to bring its device to rest.

        Raises:
            DriverError: The child ended, or took too long.
        """
        self.name, self._longest_rest_s = name, longest_rest_s
        self._connection, child_connection = SPAWN.Pipe()
        pulse = Pulse()
        self._heart = Heart(pulse, is_child=False)
        # Not a daemon: daemons are killed when their parent ends, but this child must still bring its device to rest.
        self._process = SPAWN.Process(
            target=serve, args=(make, child_connection, pulse), name=name, daemon=False
        )
        with deaf_to_the_terminal():
            start_without_main(self._process)
        child_connection.close()
        beat_for(self._process, self._heart)
        self._lock, self._send_lock = threading.RLock(), threading.Lock()
        self._number = MADE
        # On exit this process waits for its children, and the child waits for the end of the pipe: close the pipe first.
        atexit.register(self._leave)
        try:
            deadline = Deadline.after(longest_start_s)
            slow = "it has not (a busy computer? the device's longest_start_s may be larger)"
            rule = f"the process of {name} must have started"
            self._receive(STARTED, deadline, rule, slow, is_watched=False)
            # Not watched yet: constructors of compiled libraries may keep all threads of the child waiting.
            self._receive(MADE, deadline, f"{name} must have opened", "it has not", is_watched=False)
        except BaseException:
            self._abandon()
            raise

    @property
    def pid(self) -> int | None:
        """Process id of the child."""
        return self._process.pid

    @property
    def has_ended(self) -> bool:
        """Whether the child has ended."""
        return self._process.exitcode is not None

    @property
    def is_gone(self) -> bool:
        """Whether the child has ended, or gives no sign of life."""
        return self.has_ended or self._heart.is_silent

    def require_alive(self) -> None:
        """Check that the child runs and gives signs of life; sends nothing and is fast.

        Raises:
            DeviceFault: It does not.
        """
        if self.has_ended:
            raise self._ended()
        if self._heart.is_silent:
            raise self._silent()

    def call(
        self,
        method: str,
        *,
        timeout_s: float,
        is_urgent: bool = False,
        grace_s: float | None = None,
        **arguments: Any,
    ) -> Any:
        """Call a method of the device; return its result or raise its error. No call is ever sent twice.

        Args:
            method: Name of the method; it gets `timeout_s` too.
            timeout_s: Time that it may take.
            is_urgent: Ends the current call and goes first.
            grace_s: Time that the answer may take beyond that.
            arguments: Arguments by name.

        Raises:
            Unanswered: No answer of the child; the device may still be at work.
            DeviceFault: The child has ended, or gives no sign of life.
        """
        deadline = Deadline.after(timeout_s)
        if is_urgent:
            self._send(INTERRUPT)
        if not self._lock.acquire(timeout=deadline.remaining_s):
            if is_urgent:
                self._send(GIVEN_UP)
            raise _unanswered(deadline, f"{self.name} must be free", "a call of another thread goes on")
        try:
            self._number += 1
            self._send(Call(self._number, method, arguments, deadline, is_urgent))
            rule = f"{self.name} must answer"
            return self._receive(self._number, deadline, rule, "nothing received", grace_s=grace_s)
        finally:
            self._lock.release()

    def kill(self) -> None:
        """End an unresponsive child at once; the watchdog of its device has to do the rest."""
        self._process.kill()
        self._process.join(_KILLED_S)  # it owns the port until its end
        self._abandon()

    def close(self, *, timeout_s: float) -> None:
        """Let the child bring its device to rest and end.

        Raises:
            DriverError: The device is not known to be at rest; the child goes on with it (`Insistent`).
        """
        if self._process.exitcode is not None and self._connection.closed:
            return
        try:
            self.call("close", timeout_s=timeout_s, is_urgent=True)
        finally:
            self._connection.close()
            self._process.join(_GRACE_S)
            self._abandon()

    def _send(self, message: Call | str) -> None:
        try:
            with self._send_lock:
                self._connection.send(message)
        except OSError as error:
            raise self._ended() from error

    def _receive(
        self,
        number: int,
        deadline: Deadline,
        rule: str,
        received: str,
        *,
        grace_s: float | None = None,
        is_watched: bool = True,
    ) -> Any:
        limit = Deadline.after(deadline.remaining_s + (_GRACE_S if grace_s is None else grace_s))
        while True:
            try:
                if not self._connection.poll(min(BEAT_S, limit.remaining_s)):
                    if is_watched and self._heart.is_silent:
                        raise self._silent()
                    if limit.is_over:
                        raise _unanswered(deadline, rule, received)
                    continue
                answer: Answer = self._connection.recv()
            except (EOFError, OSError) as error:
                if isinstance(error, DriverError):
                    raise
                raise self._ended() from error
            self._heart.hear()
            if answer.number != number:
                continue  # of a call that was given up
            if answer.error is not None:
                raise answer.error
            return answer.value

    def _ended(self) -> DeviceFault:
        self._process.join(_GRACE_S)
        code = self._process.exitcode
        reason = _REASONS.get(code or 0, f"it ended with code {code}")
        return DeviceFault(f"the process of {self.name} must be running; {reason}")

    def _silent(self) -> DeviceFault:
        return DeviceFault(
            f"the process of {self.name} must give signs of life; it has given none for {SILENT_S:g} s (was it stopped?)"
        )

    def _leave(self) -> None:
        """End the connection at the end of this program, and wait while the child brings its device to rest."""
        self._connection.close()
        self._process.join(self._longest_rest_s)
        self._release()

    def _abandon(self) -> None:
        atexit.unregister(self._leave)
        self._connection.close()
        self._release()

    def _release(self) -> None:
        """Let this program end without its child, which may have to insist for minutes."""
        if self._process.exitcode is None:
            _LOG.warning("%s is still bringing its device to rest (process %d)", self.name, self._process.pid)
            # The only way to spare a child the wait for all children at the end of a program.
            getattr(multiprocessing.process, "_children", set()).discard(self._process)


def _unanswered(deadline: Deadline, rule: str, received: str) -> Unanswered:
    return Unanswered(str(deadline.exceeded(rule, received)))
