"""Brings the whole rig to rest when any device fails: arms stopped, currents ramped to zero, outputs off.

A watch checks the rig between commands: during a motion, a ramp, a pause, a long average, and while an arm stands.
"""

from __future__ import annotations

import logging
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import FrameType, TracebackType
from typing import NoReturn

from drivers.errors import BroughtToRest, DriverError, Refused

_LOG = logging.getLogger(__name__)


class Interlock:
    """Joins the devices of a rig. Once tripped it refuses every command: the operator must inspect the rig and open it anew.

    Attributes:
        reason: Why it tripped, in one sentence; None before.
        not_at_rest: Devices that could not be brought to rest, with the reason.
    """

    def __init__(self) -> None:
        self.reason: str | None = None
        self.not_at_rest: list[str] = []
        self._actions: dict[str, Callable[[], None]] = {}
        self._conditions: dict[str, Callable[[], None]] = {}
        self._lock = threading.Lock()
        self._has_acted = threading.Event()

    def add(self, name: str, bring_to_rest: Callable[[], None]) -> None:
        """Register the function that brings a device to rest; it is called in its own thread and must end by itself."""
        self._actions[name] = bring_to_rest

    def add_condition(self, name: str, check: Callable[[], None]) -> None:
        """Register a check that runs before each command to any device; it must be fast and raise if the command is unsafe."""
        self._conditions[name] = check

    def check_conditions(self) -> None:
        """Trip if a condition does not hold.

        Raises:
            DriverError: A condition failed; the rig has been brought to rest.
        """
        for name, check in self._conditions.items():
            with self._tripping(name):
                check()

    def require_no_trip(self) -> None:
        """Refuse a command after a fault; waits first until the rig is at rest, so that nothing interferes.

        Raises:
            BroughtToRest: The rig has tripped.
        """
        if self.reason is not None:
            self._has_acted.wait()
            raise BroughtToRest(
                f"the rig must be opened anew before it can continue; it was brought to rest because {self.reason}"
            )

    def trip(self, reason: str) -> None:
        """Bring all devices to rest at the same time, and wait for it; only the first reason is kept."""
        with self._lock:
            is_first = self.reason is None
            self.reason = self.reason or reason
        if not is_first:
            self._has_acted.wait()
            return
        _LOG.error("bringing the rig to rest because %s", reason)
        threads = [threading.Thread(target=self._bring_to_rest, args=item) for item in self._actions.items()]
        try:
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
        finally:
            self._has_acted.set()

    @contextmanager
    def guard(self, what: str) -> Iterator[None]:
        """Trip if the block or a condition of the rig fails, even by Ctrl-C; `Refused` does not trip, for nothing was sent."""
        self.require_no_trip()
        self.check_conditions()
        with self._tripping(what):
            yield

    @contextmanager
    def _tripping(self, what: str) -> Iterator[None]:
        try:
            yield
        except Refused:
            raise
        except Exception as error:
            self.trip(f"{what} failed: {str(error) or type(error).__name__}")
            raise
        except BaseException:  # Ctrl-C, SIGTERM: no fault of the device that was busy
            self.trip("the program was interrupted")
            raise

    def _bring_to_rest(self, name: str, action: Callable[[], None]) -> None:
        try:
            action()
        except Exception as error:
            _LOG.critical("%s is not known to be at rest: %s", name, error)
            self.not_at_rest.append(f"{name} is not known to be at rest: {error}")


@contextmanager
def sigterm_as_exception() -> Iterator[None]:
    """Let SIGTERM end the program through all `with` blocks, as Ctrl-C does; for the main thread only."""

    def end(number: int, _: FrameType | None) -> NoReturn:
        raise SystemExit(128 + number)

    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


WATCH_S = 0.2
"""Time between two checks: a coil takes minutes to warm up, but an emergency stop must act at once."""


class Watch:
    """Repeats checks during its `with` block, each in its own thread, until the check fails and has brought the rig to rest.

    A thermometer that takes seconds to fail therefore does not delay an emergency stop. The measuring thread learns of a
    failure at its next command, which is refused with the reason.
    """

    def __init__(self, checks: Sequence[Callable[[], None]], every_s: float = WATCH_S) -> None:
        """Take the checks, such as `GuardedSource.check_coil`."""
        self._every_s = every_s
        self._is_over = threading.Event()
        self._threads = [threading.Thread(target=self._watch, args=(check,), daemon=True) for check in checks]

    def __enter__(self) -> Watch:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._is_over.set()
        for thread in self._threads:
            thread.join()

    def _watch(self, check: Callable[[], None]) -> None:
        while not self._is_over.wait(self._every_s):
            try:
                check()
            except DriverError:
                return
