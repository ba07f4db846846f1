"""Feels the coils while nothing else asks: during a motion, a pause, a long average."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from types import TracebackType

from drivers.errors import DriverError

WATCH_S = 0.5
"""Between two looks; a coil needs minutes to warm up."""


class TemperatureWatch:
    """Runs checks again and again in its `with` block, until one fails: that one has brought the rig to rest.

    The thread that measures hears of it at its next command, which is refused with the reason.
    """

    def __init__(self, checks: Sequence[Callable[[], None]], every_s: float = WATCH_S) -> None:
        """Take the checks, such as `GuardedSource.check_temperature`."""
        self._checks, self._every_s = tuple(checks), every_s
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="temperature watch", daemon=True)

    def __enter__(self) -> TemperatureWatch:
        if self._checks:
            self._thread.start()
        return self

    def __exit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._is_over.set()
        if self._checks:
            self._thread.join()

    def _watch(self) -> None:
        while not self._is_over.wait(self._every_s):
            for check in self._checks:
                try:
                    check()
                except DriverError:
                    return
