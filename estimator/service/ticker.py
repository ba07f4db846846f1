"""A thread that calls a function periodically, and logs its exceptions."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

log = logging.getLogger("coilcal.service")


class Ticker:
    """Calls a function until it is told to end, which sets `stopping`.

    Args:
        name: What is done, in words.
        every_s: Pause between two calls.
        call: The function; what it raises is logged.
    """

    def __init__(self, name: str, every_s: float, call: Callable[[], object]) -> None:
        self._name, self._every_s, self._call = name, every_s, call
        self.stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"coilcal {name}", daemon=True)

    def start(self) -> None:
        """Begin to call."""
        self._thread.start()

    def stop(self) -> None:
        """End, after the call that is under way."""
        self.stopping.set()
        if self._thread.is_alive():
            self._thread.join(timeout=30)

    def _run(self) -> None:
        while not self.stopping.is_set():
            try:
                self._call()
            except Exception:  # such as a disk that is full for a while
                log.exception("%s failed; it is tried again", self._name)
            self.stopping.wait(self._every_s)
