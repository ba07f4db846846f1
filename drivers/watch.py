"""Checks the rig between commands: during a motion, a ramp, a pause, a long average, and while an arm stands."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from types import TracebackType

from drivers.errors import DriverError

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
