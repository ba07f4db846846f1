"""Runs a device in a child process, which outlives its parent until the device is at rest.

The end of the parent, even by SIGKILL, closes the pipe between the two. The child sees that, ramps the current to zero or stops
the arm, and ends. And a library that crashes (ur_rtde does when its connection drops) takes the child with it, not the
measurement. If the whole computer dies, only the watchdogs of the instruments help.
"""

from __future__ import annotations

import atexit
import logging
import os
import queue
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, Protocol, runtime_checkable

from drivers.children import SPAWN, start_without_main
from drivers.deadline import Deadline
from drivers.errors import DeviceFault, DriverError

_LOG = logging.getLogger(__name__)

_KEEP_ALIVE_S = 0.05
_GRACE_S = 0.5
"""Time that an answer may take beyond the deadline of its call; the child keeps the deadline itself."""
LONGEST_START_S = 60.0
"""Unless the settings say otherwise. A child that fails is heard of at once, so this is for one that a busy computer gives no time."""


@runtime_checkable
class KeptAlive(Protocol):
    """A device that expects a regular sign of life, and whose connection may break for good."""

    is_lost: bool
    """True ends the process at once, without another message to the device."""

    def keep_alive(self) -> None:
        """Give a sign of life; called every 50 ms while idle."""
        ...


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
_LOST = 3
"""Exit code of a child whose connection to its device broke."""


def end_at_once() -> None:
    """End this process without running destructors: a library that reconnects might send its last command again."""
    os._exit(_LOST)


class Supervised:
    """The parent's end: calls methods of a device in a child process."""

    def __init__(self, make: Callable[[threading.Event], Any], name: str, *, longest_start_s: float) -> None:
        """Start the child and wait until its device is made.

        Args:
            make: Importable function that makes the device in the child. Its argument is set when the current call should end.
            name: Name of the device in messages.
            longest_start_s: Time for starting the child and making the device.

        Raises:
            DriverError: The child ended, or took too long.
        """
        self.name = name
        self._connection, child_connection = SPAWN.Pipe()
        # Not a daemon: daemons are killed when their parent ends, but this child must still bring its device to rest.
        self._process = SPAWN.Process(target=_serve, args=(make, child_connection), name=name, daemon=False)
        start_without_main(self._process)
        child_connection.close()
        self._lock, self._send_lock = threading.RLock(), threading.Lock()
        self._number = _MADE
        # On exit this process waits for its children, and the child waits for the end of the pipe: close the pipe first.
        atexit.register(self._connection.close)
        try:
            deadline = Deadline.after(longest_start_s)
            slow = "it has not (a busy computer? the device's longest_start_s may be larger)"
            self._receive(_STARTED, deadline, f"the process of {name} must have started", slow)
            self._receive(_MADE, deadline, f"{name} must have opened", "it has not")
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

    def call(self, method: str, *, timeout_s: float, is_urgent: bool = False, **arguments: Any) -> Any:
        """Call a method of the device; return its result or raise its error. No call is ever sent twice.

        Args:
            method: Name of the method; it gets `timeout_s` too.
            timeout_s: Time that it may take.
            is_urgent: Ends the current call and goes first.
            arguments: Arguments by name.

        Raises:
            DeadlineExceeded: No answer; the device may still be at work.
            DeviceFault: The child has ended.
        """
        deadline = Deadline.after(timeout_s)
        if is_urgent:
            self._send(_INTERRUPT)
        if not self._lock.acquire(timeout=deadline.remaining_s):
            if is_urgent:
                self._send(_GIVEN_UP)
            raise deadline.exceeded(f"{self.name} must be free", "a call of another thread goes on")
        try:
            self._number += 1
            self._send(_Call(self._number, method, arguments, deadline, is_urgent))
            return self._receive(self._number, deadline, f"{self.name} must answer", "nothing received")
        finally:
            self._lock.release()

    def kill(self) -> None:
        """End an unresponsive child at once; the watchdog of its device has to do the rest."""
        self._process.kill()
        self._process.join(_GRACE_S)
        self._abandon()

    def close(self, *, timeout_s: float) -> None:
        """Let the child bring its device to rest and end.

        Raises:
            DriverError: The device is not known to be at rest.
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

    def _receive(self, number: int, deadline: Deadline, rule: str, received: str) -> Any:
        while True:
            try:
                if not self._connection.poll(deadline.remaining_s + _GRACE_S):
                    raise deadline.exceeded(rule, received)
                answer: _Answer = self._connection.recv()
            except (EOFError, OSError) as error:
                if isinstance(error, DriverError):
                    raise
                raise self._ended() from error
            if answer.number != number:
                continue  # of a call that was given up
            if answer.error is not None:
                raise answer.error
            return answer.value

    def _ended(self) -> DeviceFault:
        self._process.join(_GRACE_S)
        code = self._process.exitcode
        reason = "its connection to the device broke" if code == _LOST else f"it ended with code {code}"
        return DeviceFault(f"the process of {self.name} must be running; {reason}")

    def _abandon(self) -> None:
        atexit.unregister(self._connection.close)
        self._connection.close()
        if self._process.exitcode is None:
            _LOG.warning("%s is still bringing its device to rest", self.name)


def _serve(make: Callable[[threading.Event], Any], connection: Connection) -> None:
    """Main function of the child."""
    os.setsid()  # Ctrl-C in the terminal goes to the parent only, which then closes the device in order
    interrupt, is_given_up = threading.Event(), threading.Event()
    calls: queue.SimpleQueue[_Call | None] = queue.SimpleQueue()

    def end(*_: object) -> None:
        interrupt.set()
        calls.put(None)

    def listen() -> None:
        while True:
            try:
                message = connection.recv()
            except (EOFError, OSError):
                end()
                return
            if isinstance(message, _Call):
                calls.put(message)
            else:
                (interrupt if message == _INTERRUPT else is_given_up).set()

    signal.signal(signal.SIGTERM, end)
    _answer(connection, _Answer(_STARTED, None, None))
    threading.Thread(target=listen, daemon=True).start()
    try:
        device = make(interrupt)
    except Exception as error:
        _answer(connection, _Answer(_MADE, None, _portable(error)))
        return
    _answer(connection, _Answer(_MADE, None, None))
    _work(device, calls, interrupt, is_given_up, connection)


def _work(
    device: Any,
    calls: queue.SimpleQueue[_Call | None],
    interrupt: threading.Event,
    is_given_up: threading.Event,
    connection: Connection,
) -> None:
    while True:
        call = _next_call(device, calls)
        if call is None or call.method == "close":
            break
        if call.is_urgent or is_given_up.is_set():
            # The interrupt has served its purpose: its caller is served now, or has given up.
            interrupt.clear()
            is_given_up.clear()
        _answer(connection, _carry_out(device, call))
        if isinstance(device, KeptAlive) and device.is_lost:
            end_at_once()
    interrupt.clear()
    error = None
    try:
        device.close()
    except Exception as fault:
        error = _portable(fault)
    if call is not None:
        _answer(connection, _Answer(call.number, None, error))
    elif error is not None:
        _LOG.error("the parent is gone, and bringing the device to rest failed: %s", error)
    # The device is closed; the destructors of ur_rtde would only take one more second.
    logging.shutdown()
    os._exit(0)


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


def _portable(error: Exception) -> Exception:
    """An error that can be pickled for the pipe; errors of libraries may not be."""
    return error if isinstance(error, DriverError) else DeviceFault(f"{type(error).__name__}: {error}")


def _answer(connection: Connection, answer: _Answer) -> None:
    try:
        connection.send(answer)
    except OSError:
        _LOG.info("the parent did not wait for answer %d at %.3f s", answer.number, time.monotonic())
