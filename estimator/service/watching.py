"""Estimates of open sessions while somebody watches them: a thread for each session, woken when readings have been appended.

Watchers get the present state and never queue up: a slow one gets more readings in one event.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections import Counter
from collections.abc import AsyncGenerator, Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from estimator.errors import CoilcalError
from estimator.live.engine import WAIT_S, LiveEngine, Step
from estimator.live.refresh import FEWEST_READINGS, GROWTH, Refreshed
from estimator.service.live_state import Drawn, LiveState, Seen, verdict_of, with_estimate
from estimator.service.problems import check_limits
from estimator.service.running_diagnosis import RunningDiagnosis
from estimator.store.session import Session

LOOK_EVERY_S = 1.0  # for the end of the session, and whether anybody watches still
RETRY_AFTER_S = 60


class Watched:
    """One open session with its estimate, until `leave`.

    Args:
        path: Folder of the session.
    Raises:
        InvalidInput: The rig has no free parameter.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._engine, self._drawn = path, LiveEngine(path), Drawn()
        self._refreshed: Refreshed | None = None
        self._n_diagnosed = 0
        self._waits_since_s: float | None = None
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

    @property
    def waits_since_s(self) -> float | None:
        """When the session had grown enough for another diagnosis, by the monotonic clock; None if it has not."""
        return self._waits_since_s

    def so_far(self) -> Session:
        """The readings that were taken up to now."""
        with self._lock:
            self._waits_since_s, self._n_diagnosed = None, len(self._engine.entries)
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
            if self._waits_since_s is None and len(self._engine.entries) >= wanted:
                self._waits_since_s = time.monotonic()

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


class Watching:
    """The sessions that are watched now.

    Args:
        path: Folder of a session, by its id.
        most: Sessions that may be watched at once.
        is_diagnosed: Whether they are diagnosed as they grow.
    """

    def __init__(self, path: Callable[[str], Path], most: int, is_diagnosed: bool) -> None:
        self._path, self._most = path, most
        self._watched: dict[str, Watched] = {}
        self._n_watchers: Counter[str] = Counter()
        self._lock = threading.Lock()
        self._is_diagnosed, self._diagnosis = is_diagnosed, RunningDiagnosis(self._all)

    def diagnose(self) -> None:
        """Diagnose sessions one after another while some are watched and have grown."""
        if self._is_diagnosed:
            self._diagnosis.look()

    def _all(self) -> list[Watched]:
        with self._lock:
            return list(self._watched.values())

    def wake(self, session_id: str) -> None:
        """A session has new readings, or was closed."""
        if (watched := self._watched.get(session_id)) is not None:
            watched.wake()

    @contextmanager
    def watched(self, session_id: str) -> Iterator[Watched]:
        """An open session while it is watched.

        Raises:
            Problem: Too many sessions are watched.
            InvalidInput: The rig has no free parameter.
        """
        with self._lock:
            if session_id not in self._watched:
                limits = {"watched sessions": (len(self._watched), self._most)}
                check_limits(limits, 429, "must be at most {} at once", RETRY_AFTER_S)
                self._watched[session_id] = Watched(self._path(session_id))
            self._n_watchers[session_id] += 1
            watched = self._watched[session_id]
        try:
            yield watched
        finally:
            with self._lock:
                self._n_watchers[session_id] -= 1
                if not self._n_watchers[session_id]:
                    del self._n_watchers[session_id]
                    self._watched.pop(session_id, None)
                    watched.leave()

    def stop(self) -> None:
        """End all threads."""
        self._diagnosis.stopping.set()
        for watched in self._all():
            watched.leave()
