"""The child's end of a supervised device (`drivers.supervised`): carries out calls, and ends when the device is at rest."""

from __future__ import annotations

import logging
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

from drivers.deadline import Deadline
from drivers.errors import DeviceFault, DriverError
from drivers.pulse import Heart, Pulse, beat_until_silent

_LOG = logging.getLogger(__name__)

_KEEP_ALIVE_S = 0.05


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


@dataclass(frozen=True, slots=True)
class Call:
    """A method of the device that the parent calls, with its arguments and deadline."""

    number: int
    method: str
    arguments: dict[str, Any]
    deadline: Deadline
    is_urgent: bool


@dataclass(frozen=True, slots=True)
class Answer:
    """What a call returned or raised."""

    number: int
    value: Any
    error: Exception | None


INTERRUPT, GIVEN_UP = "interrupt", "given up"
STARTED, MADE = 0, 1
"""Numbers of the answers that come before those to calls: the child runs, and its device is made."""
LOST, LEFT = 3, 4
"""Exit codes of a child whose connection to its device broke, and of one that heard nothing from its parent."""


def end_at_once() -> None:
    """End this process without running destructors: a library that reconnects might send its last command again."""
    os._exit(LOST)


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
    calls: queue.SimpleQueue[Call | None] = field(default_factory=queue.SimpleQueue)
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
            if isinstance(message, Call):
                self.calls.put(message)
            else:
                (self.interrupt if message == INTERRUPT else self.is_given_up).set()


def serve(make: Callable[[threading.Event], Any], connection: Connection, pulse: Pulse) -> None:
    """Main function of the child."""
    os.setsid()  # Ctrl-Z in the terminal goes to the parent only
    orders = _Orders(connection)
    signal.signal(signal.SIGTERM, lambda *_: orders.end())
    _answer(connection, Answer(STARTED, None, None))
    threading.Thread(target=orders.listen, daemon=True).start()
    beat_until_silent(Heart(pulse, is_child=True), lambda: orders.end(LEFT))
    try:
        device = make(orders.interrupt)
    except Exception as error:
        _answer(connection, Answer(MADE, None, _portable(error)))
        return
    _answer(connection, Answer(MADE, None, None))
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
        _answer(orders.connection, Answer(call.number, None, error))
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


def _next_call(device: Any, calls: queue.SimpleQueue[Call | None]) -> Call | None:
    if not isinstance(device, KeptAlive):
        return calls.get()
    while True:
        try:
            return calls.get(timeout=_KEEP_ALIVE_S)
        except queue.Empty:
            device.keep_alive()


def _carry_out(device: Any, call: Call) -> Answer:
    if call.deadline.is_over:
        # A late call must not be carried out: the caller has moved on.
        error = call.deadline.exceeded(f"{call.method} must begin", "the device was busy, so it did not")
        return Answer(call.number, None, error)
    try:
        value = getattr(device, call.method)(timeout_s=call.deadline.remaining_s, **call.arguments)
    except Exception as error:
        return Answer(call.number, None, _portable(error))
    return Answer(call.number, value, None)


def _portable(error: Exception) -> Exception:
    """An error that can be pickled for the pipe; errors of libraries may not be."""
    return error if isinstance(error, DriverError) else DeviceFault(f"{type(error).__name__}: {error}")


def _answer(connection: Connection, answer: Answer) -> None:
    try:
        connection.send(answer)
    except OSError:
        _LOG.info("the parent did not wait for answer %d at %.3f s", answer.number, time.monotonic())
