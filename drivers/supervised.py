"""Runs a device in a child process, which outlives its parent until the device is at rest.

The end of the parent, even by SIGKILL, closes the pipe between the two. The child sees that, ramps the current to zero or stops
the arm, and ends. A parent that is stopped (SIGSTOP, Ctrl-Z) is heard no more (`drivers.pulse`), with the same consequence; a child that is
stopped or hangs is noticed in the same way. And a library that crashes (ur_rtde does when its connection drops) takes the child with it,
not the measurement. If both processes or the whole computer stop, only the watchdogs of the instruments help.
"""

from __future__ import annotations

import atexit
import logging
import multiprocessing.process
import os
import queue
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from typing import Any, Protocol, runtime_checkable

from drivers.children import SPAWN, start_without_main
from drivers.deadline import Deadline
from drivers.errors import DeadlineExceeded, DeviceFault, DriverError
from drivers.pulse import BEAT_S, SILENT_S, Heart, Pulse, beat_for, beat_until_silent

_LOG = logging.getLogger(__name__)

_KEEP_ALIVE_S = 0.05
_GRACE_S = 0.5
"""Time that an answer may take beyond the deadline of its call; the child keeps the deadline itself."""
_KILLED_S = 10.0
"""Time that the end of a killed child may take on a busy computer."""
LONGEST_START_S = 60.0
"""Unless the settings say otherwise. A child that fails is heard of at once, so this is for one that a busy computer gives no time."""


LONGEST_REST_S = 10.0
"""Unless the settings say otherwise, time that a device may take to come to rest."""


@runtime_checkable
class KeptAlive(Protocol):
    """A device that expects a regular sign of life, and whose connection may break for good."""

    is_lost: bool
    """True ends the process at once, without another message to the device."""

    def keep_alive(self) -> None:
        """Give a sign of life; called every 50 ms while idle."""
        ...


@runtime_checkable
class Insistent(Protocol):
    """A device that must not be given up while it is not known to be at rest; `close` does both, without the second part."""

    def come_to_rest(self) -> None:
        """Bring the device to rest; its connection stays open.

        Raises:
            DriverError: It is not known to be at rest.
        """
        ...

    def insist(self) -> None:
        """Go on bringing it to rest until it confirms that, or for as long as makes sense.

        Raises:
            DriverError: It has not confirmed it.
        """
        ...


class Unanswered(DeadlineExceeded):
    """No answer of the child, which keeps the deadlines of its device itself: it hangs."""


@dataclass(frozen=True, slots=True)
class _Call:
    number: int
    method: str
    arguments: dict[str, Any]
    deadline: Deadline
    is_urgent: bool


@dataclass(frozen=True, slots=True)
class _Answer:
    number: int
    value: Any
    error: Exception | None


_INTERRUPT, _GIVEN_UP = "interrupt", "given up"
_STARTED, _MADE = 0, 1
"""Numbers of the answers that come before those to calls: the child runs, and its device is made."""
_LOST, _LEFT = 3, 4
"""Exit codes of a child whose connection to its device broke, and of one that heard nothing from its parent."""
_REASONS = {
    _LOST: "its connection to the device broke",
    _LEFT: f"it heard nothing from this program for {SILENT_S:g} s (was it stopped?) and brought its device to rest",
}


def end_at_once() -> None:
    """End this process without running destructors: a library that reconnects might send its last command again."""
    os._exit(_LOST)


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
            target=_serve, args=(make, child_connection, pulse), name=name, daemon=False
        )
        start_without_main(self._process)
        child_connection.close()
        beat_for(self._process, self._heart)
        self._lock, self._send_lock = threading.RLock(), threading.Lock()
        self._number = _MADE
        # On exit this process waits for its children, and the child waits for the end of the pipe: close the pipe first.
        atexit.register(self._leave)
        try:
            deadline = Deadline.after(longest_start_s)
            slow = "it has not (a busy computer? the device's longest_start_s may be larger)"
            rule = f"the process of {name} must have started"
            self._receive(_STARTED, deadline, rule, slow, is_watched=False)
            # Not watched yet: constructors of compiled libraries may keep all threads of the child waiting.
            self._receive(_MADE, deadline, f"{name} must have opened", "it has not", is_watched=False)
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
            self._send(_INTERRUPT)
        if not self._lock.acquire(timeout=deadline.remaining_s):
            if is_urgent:
                self._send(_GIVEN_UP)
            raise _unanswered(deadline, f"{self.name} must be free", "a call of another thread goes on")
        try:
            self._number += 1
            self._send(_Call(self._number, method, arguments, deadline, is_urgent))
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

    def _send(self, message: _Call | str) -> None:
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
                answer: _Answer = self._connection.recv()
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


@dataclass
class _Orders:
    """Orders of the parent, as its child's threads pass them on.

    Attributes:
        connection: Pipe to the parent.
        calls: Calls to carry out; None ends the child.
        interrupt: Set when the current call should end.
        is_given_up: Set when the caller of an urgent call waits no longer.
        exit_code: With which the child will end.
    """

    connection: Connection
    calls: queue.SimpleQueue[_Call | None] = field(default_factory=queue.SimpleQueue)
    interrupt: threading.Event = field(default_factory=threading.Event)
    is_given_up: threading.Event = field(default_factory=threading.Event)
    exit_code: int = 0

    def end(self, exit_code: int = 0) -> None:
        """End the current call and then the child."""
        self.exit_code = self.exit_code or exit_code
        self.interrupt.set()
        self.calls.put(None)

    def listen(self) -> None:
        """Take what the parent sends, until its end."""
        while True:
            try:
                message = self.connection.recv()
            except (EOFError, OSError):
                self.end()
                return
            if isinstance(message, _Call):
                self.calls.put(message)
            else:
                (self.interrupt if message == _INTERRUPT else self.is_given_up).set()


def _serve(make: Callable[[threading.Event], Any], connection: Connection, pulse: Pulse) -> None:
    """Main function of the child."""
    os.setsid()  # Ctrl-C and Ctrl-Z in the terminal go to the parent only; after Ctrl-C, it closes the device in order
    orders = _Orders(connection)
    signal.signal(signal.SIGTERM, lambda *_: orders.end())
    _answer(connection, _Answer(_STARTED, None, None))
    threading.Thread(target=orders.listen, daemon=True).start()
    beat_until_silent(Heart(pulse, is_child=True), lambda: orders.end(_LEFT))
    try:
        device = make(orders.interrupt)
    except Exception as error:
        _answer(connection, _Answer(_MADE, None, _portable(error)))
        return
    _answer(connection, _Answer(_MADE, None, None))
    _work(device, orders)


def _work(device: Any, orders: _Orders) -> None:
    while True:
        call = _next_call(device, orders.calls)
        if call is None or call.method == "close":
            break
        if call.is_urgent or orders.is_given_up.is_set():
            # The interrupt has served its purpose: its caller is served now, or has given up.
            orders.interrupt.clear()
            orders.is_given_up.clear()
        _answer(orders.connection, _carry_out(device, call))
        if isinstance(device, KeptAlive) and device.is_lost:
            end_at_once()
    orders.interrupt.clear()
    error = _error_of(device.come_to_rest) if isinstance(device, Insistent) else None
    error = error or _error_of(device.close)
    if call is not None:
        _answer(orders.connection, _Answer(call.number, None, error))
    elif error is not None:
        _LOG.error("the program is gone, and bringing the device to rest failed: %s", error)
    if error is not None and isinstance(device, Insistent):
        _detach()
        _error_of(device.insist)
    # The device is at rest; the destructors of ur_rtde would only take one more second.
    logging.shutdown()
    os._exit(orders.exit_code)


def _error_of(action: Callable[[], None]) -> Exception | None:
    """What an action raises, in a form that can cross the pipe."""
    try:
        action()
    except Exception as fault:
        return _portable(fault)
    return None


def _detach() -> None:
    """Keep neither the outputs of the program nor its end from anybody who waits for them; SIGTERM ends this process at once."""
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    nothing = os.open(os.devnull, os.O_RDWR)
    for descriptor in range(3):
        os.dup2(nothing, descriptor)
    # The tracker of shared memory has the outputs too; it ends with the last process that may talk to it.
    tracker = resource_tracker.getfd()
    if tracker is not None:
        os.close(tracker)


def _next_call(device: Any, calls: queue.SimpleQueue[_Call | None]) -> _Call | None:
    if not isinstance(device, KeptAlive):
        return calls.get()
    while True:
        try:
            return calls.get(timeout=_KEEP_ALIVE_S)
        except queue.Empty:
            device.keep_alive()


def _carry_out(device: Any, call: _Call) -> _Answer:
    if call.deadline.is_over:
        # A late call must not be carried out: the caller has moved on.
        error = call.deadline.exceeded(f"{call.method} must begin", "the device was busy, so it did not")
        return _Answer(call.number, None, error)
    try:
        value = getattr(device, call.method)(timeout_s=call.deadline.remaining_s, **call.arguments)
    except Exception as error:
        return _Answer(call.number, None, _portable(error))
    return _Answer(call.number, value, None)


def _unanswered(deadline: Deadline, rule: str, received: str) -> Unanswered:
    return Unanswered(str(deadline.exceeded(rule, received)))


def _portable(error: Exception) -> Exception:
    """An error that can be pickled for the pipe; errors of libraries may not be."""
    return error if isinstance(error, DriverError) else DeviceFault(f"{type(error).__name__}: {error}")


def _answer(connection: Connection, answer: _Answer) -> None:
    try:
        connection.send(answer)
    except OSError:
        _LOG.info("the parent did not wait for answer %d at %.3f s", answer.number, time.monotonic())
