"""The open sessions that somebody watches, each with one estimate for all its watchers."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from estimator.service.problems import check_limits
from estimator.service.running_diagnosis import RunningDiagnosis
from estimator.service.watched import Watched

RETRY_AFTER_S = 60


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
        self._is_diagnosed, self._diagnosis = is_diagnosed, RunningDiagnosis()

    def diagnose(self) -> None:
        """Go on with the diagnosis of sessions that have grown; called again and again, by one thread at a time."""
        if self._is_diagnosed:
            self._diagnosis.look(self._all())

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
        """End all threads, and the process of the diagnosis, with which nobody may go on meanwhile."""
        self._diagnosis.stop()
        for watched in self._all():
            watched.leave()
