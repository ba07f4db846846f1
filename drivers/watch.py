"""Looks after the rig while nothing else asks: during a motion, a ramp, a pause, a long average, and while an arm stands."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from types import TracebackType

from drivers.errors import DriverError

WATCH_S = 0.2
"""Between two looks: a coil needs minutes to warm up, and whoever presses an emergency stop expects it at once."""


class Watch:
    """Runs checks again and again in its `with` block, each in a thread of its own, until it fails: then it has brought the rig to rest.

    One thermometer that takes seconds to fail does not keep an emergency stop from being heard. The thread that measures
    hears of a failure at its next command, which is refused with the reason.
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
