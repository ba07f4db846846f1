"""The estimate of an open session while somebody watches it: a thread, woken when readings have been appended.

Watchers get the present state and never queue up: a slow one gets more readings in one event.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import AsyncGenerator, Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from estimator.errors import CoilcalError
from estimator.live.engine import WAIT_S, LiveEngine, Step
from estimator.live.refresh import FEWEST_READINGS, GROWTH, Refreshed
from estimator.service.live_state import Drawn, LiveState, Seen, verdict_of, with_estimate
from estimator.store.session import Session

LOOK_EVERY_S = 1.0  # for the end of the session, and whether anybody watches still


class Watched:
    """One open session with its estimate, until `leave`.

    Args:
        path: Folder of the session.
    Attributes:
        waits_since_s: When the session had grown enough for another diagnosis, by the monotonic clock; None if it has not.
    Raises:
        InvalidInput: The rig has no free parameter.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._engine, self._drawn = path, LiveEngine(path), Drawn()
        self._refreshed: Refreshed | None = None
        self._n_diagnosed = 0
        self.waits_since_s: float | None = None
        self._is_left = False
        self._wake, self._lock = threading.Event(), threading.Lock()
        self._watchers: set[tuple[asyncio.AbstractEventLoop, asyncio.Event]] = set()
        threading.Thread(target=self._run, name="coilcal watching", daemon=True).start()

    async def states(self, is_ending: Callable[[], bool]) -> AsyncGenerator[LiveState]:
        """States of the session, from its first reading on; the last one has `has_ended`."""
        changed, seen = asyncio.Event(), Seen()
        mine = asyncio.get_running_loop(), changed
        with self._lock:
            self._watchers.add(mine)
        try:
            while not is_ending():
                changed.clear()
                state, seen = self.state_after(seen)
                yield state
                if state.has_ended:
                    return
                while not (changed.is_set() or is_ending()):
                    with suppress(TimeoutError):
                        async with asyncio.timeout(LOOK_EVERY_S):
                            await changed.wait()
        finally:
            with self._lock:
                self._watchers.discard(mine)

    def state_after(self, seen: Seen) -> tuple[LiveState, Seen]:
        """The present state for a watcher, and what that has got then."""
        return self._drawn.after(seen, self._engine, self._path)

    def wake(self) -> None:
        """There are new readings, or the session was closed."""
        self._wake.set()

    def leave(self) -> None:
        """End the thread at its next look."""
        self._is_left = True
        self._wake.set()

    @property
    def is_left(self) -> bool:
        """Whether nobody watches, or no reading follows."""
        return self._is_left or self._drawn.state.has_ended

    def so_far(self) -> Session:
        """The readings that were taken up to now."""
        with self._lock:
            self.waits_since_s, self._n_diagnosed = None, len(self._engine.entries)
        return self._engine.session()

    def take(self, refreshed: Refreshed) -> None:
        """Tell of a diagnosis, and go on from its optimum where that is better."""
        self._refreshed = refreshed
        self._wake.set()

    def _run(self) -> None:
        try:
            while not self._is_left:
                self._wake.clear()
                self._take_diagnosis()
                step = self._engine.step()
                if step is Step.READINGS:
                    self._show(self._drawn.with_readings(self._engine))
                    self._note_growth()
                elif step is Step.POLISHED:
                    self._learn()
                elif step is Step.IDLE:
                    self._wake.wait(WAIT_S if self._engine.stream.can_polish else LOOK_EVERY_S)
                elif step is Step.ENDED:
                    break
        except CoilcalError as error:
            self._learn(fault=str(error))
        except FileNotFoundError:
            self._learn(fault="session must be there to be followed; it was deleted")
        except Exception:
            self._learn(fault="estimate must follow the readings; it failed")
            raise
        finally:
            self._learn(has_ended=True)

    def _take_diagnosis(self) -> None:
        refreshed, self._refreshed = self._refreshed, None
        if refreshed is not None:
            self._engine.improve(refreshed.best)
            self._learn(diagnosis=verdict_of(refreshed))

    def _note_growth(self) -> None:
        with self._lock:
            wanted = max(FEWEST_READINGS, GROWTH * self._n_diagnosed)
            if self.waits_since_s is None and len(self._engine.entries) >= wanted:
                self.waits_since_s = time.monotonic()

    def _learn(self, **known: Any) -> None:
        """Tell what is known from now on, with the present intervals."""
        state = replace(with_estimate(self._drawn.state, self._engine), **known)
        self._show(replace(self._drawn, state=state))

    def _show(self, drawn: Drawn) -> None:
        """Replace the state, which only the thread of the session does, and wake the watchers."""
        self._drawn = drawn
        with self._lock:
            watchers = list(self._watchers)
        for loop, event in watchers:
            with suppress(RuntimeError):  # the loop has ended
                loop.call_soon_threadsafe(event.set)
