"""Signs of life between a program and its child process: each hears within seconds that the other one is stopped or hangs.

The end of a process closes its pipes. One that is stopped (SIGSTOP, Ctrl-Z, a debugger) or hangs keeps them open and says nothing, so each
side counts up a number in shared memory, from a thread of its own, and watches the number of the other. Nothing can fill up or block.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from multiprocessing.connection import wait
from multiprocessing.context import SpawnProcess

from drivers.children import SPAWN

BEAT_S = 0.25
"""Time between two signs of life."""

SILENT_S = 5.0
"""Silence after which a process is taken to be stopped: five times the longest pause that a busy computer was seen to give a process."""

_BEATS = round(SILENT_S / BEAT_S)


class Pulse:
    """The two counters; picklable while a child is started.

    Attributes:
        counts: Signs of life of the parent and of the child.
    """

    def __init__(self) -> None:
        self.counts = SPAWN.RawArray("L", 2)


class Heart:
    """One side: gives signs of life and notes those of the other side.

    Silence is counted in own beats and not in time, so that a pause of the whole computer makes nobody silent.
    """

    def __init__(self, pulse: Pulse, *, is_child: bool) -> None:
        self._counts = pulse.counts
        self._own, self._other = (1, 0) if is_child else (0, 1)
        self._heard = 0
        self._was_ever_heard = is_child  # the parent has just started it
        self._n_silent = 0

    @property
    def is_silent(self) -> bool:
        """Whether the other side, once heard, has given no sign of life for `SILENT_S`."""
        return self._n_silent >= _BEATS

    def beat(self) -> None:
        """Give a sign of life, and look for one of the other side; called every `BEAT_S`."""
        self._counts[self._own] += 1
        heard = self._counts[self._other]
        if heard != self._heard:
            self._heard = heard
            self.hear()
        elif self._was_ever_heard:
            self._n_silent += 1

    def hear(self) -> None:
        """Note another sign of life, such as an answer."""
        self._was_ever_heard = True
        self._n_silent = 0


def beat_for(process: SpawnProcess, heart: Heart) -> None:
    """Beat in a thread of the parent as long as a child lives."""

    def go_on() -> None:
        while not wait([process.sentinel], BEAT_S):
            heart.beat()

    threading.Thread(target=go_on, name=f"pulse of {process.name}", daemon=True).start()


def beat_until_silent(heart: Heart, on_silence: Callable[[], None]) -> None:
    """Beat in a thread of the child as long as it lives; call a function once, when the parent has fallen silent."""

    def go_on() -> None:
        was_told = False
        while True:
            time.sleep(BEAT_S)
            heart.beat()
            if heart.is_silent and not was_told:
                was_told = True
                on_silence()

    threading.Thread(target=go_on, name="pulse", daemon=True).start()
