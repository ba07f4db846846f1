"""Estimates of open sessions while somebody watches them: a thread for each session, woken when readings have been appended.

Watchers are told of the present state and never queue up: who is slow gets more readings in one event.
"""

from __future__ import annotations

import asyncio
import statistics
import threading
import time
from collections import Counter
from collections.abc import AsyncGenerator, Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

from estimator.errors import CoilcalError
from estimator.live.outlines import outlines
from estimator.live.places import Place, places
from estimator.live.refresh import FEWEST_READINGS, Refreshed
from estimator.live.refresh import GROWTH as GROWTH_OF_DIAGNOSIS
from estimator.live.spare import WAIT_S, SpareTime
from estimator.live.stream import Stream
from estimator.service.devices import updated
from estimator.service.news import News, Verdict, Widths
from estimator.service.problems import check_limits
from estimator.service.running_diagnosis import RunningDiagnosis
from estimator.store.follow import Follower
from estimator.store.growing import observations_of
from estimator.store.journal import Entry
from estimator.store.made import JOURNAL
from estimator.store.session import Session

LOOK_EVERY_S = 1.0  # for the end of the session, and whether anybody watches still
# Readings that were there before are taken in growing parts, so that the intervals have a past.
FIRST, GROWTH = 10, 1.6
REDRAWN_AT = 1.25  # growth of a session after which the residuals of all its readings are computed anew
MOST_PLACES = 2_000  # that are shown, the last ones
HISTORY_STEP = 1.01  # growth of a session between two entries of its history
RETRY_AFTER_S = 60
PACED, FEWEST_PACED = 50, 3  # readings that tell how often they come


class Watched:
    """One open session with its estimate, until `leave`.

    Args:
        path: Folder of the session.
    Raises:
        InvalidInput: The rig has no free parameter.
    """

    def __init__(self, path: Path) -> None:
        self._follower, self._journal = Follower(path), path / JOURNAL
        self._rig = self._follower.rig
        self._stream, self._spare = Stream(self._rig), SpareTime()
        self._entries: list[Entry] = []
        self._known = News()  # all of it; a watcher is told what is new
        self._n_drawn, self._drawing = 0, 0
        self._refreshed: Refreshed | None = None
        self._n_diagnosed = 0
        self._waits_since_s: float | None = None
        self._is_left = False
        self._wake, self._lock = threading.Event(), threading.Lock()
        self._watchers: set[tuple[asyncio.AbstractEventLoop, asyncio.Event]] = set()
        threading.Thread(target=self._run, name="coilcal watching", daemon=True).start()

    async def news(self, is_ending: Callable[[], bool]) -> AsyncGenerator[News]:
        """What becomes of the session, from its first reading on; the last news have `has_ended`."""
        changed = asyncio.Event()
        mine = asyncio.get_running_loop(), changed
        drawing, n_places, n_history = -1, 0, 0
        with self._lock:
            self._watchers.add(mine)
        try:
            while not is_ending():
                changed.clear()
                drawing, n_places, news = self._news(drawing, n_places, n_history)
                n_history = news.history[-1].n_readings if news.history else n_history
                yield news
                if news.has_ended:
                    return
                while not (changed.is_set() or is_ending()):
                    with suppress(TimeoutError):
                        async with asyncio.timeout(LOOK_EVERY_S):
                            await changed.wait()
        finally:
            with self._lock:
                self._watchers.discard(mine)

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
        return self._is_left or self._known.has_ended

    @property
    def waits_since_s(self) -> float | None:
        """When the session had grown enough for another diagnosis, by the monotonic clock; None if it has not."""
        return self._waits_since_s

    def so_far(self) -> Session:
        """The readings that were taken up to now."""
        with self._lock:
            entries, self._waits_since_s = list(self._entries), None
            self._n_diagnosed = len(entries)
        return Session(self._rig, observations_of(entries, self._rig), str(self._follower.header["source"]))

    def take(self, refreshed: Refreshed) -> None:
        """Tell of a diagnosis, and go on from its optimum where that is better."""
        self._refreshed = refreshed
        self._wake.set()

    def _news(self, drawing: int, n_places: int, n_history: int) -> tuple[int, int, News]:
        """What a watcher is to be told that knows one drawing, its places up to a number and its history up to one.

        Returns: Number of the drawing, number of the last reading, and the news.
        """
        with self._lock:
            known, is_redrawn = self._known, drawing != self._drawing
            after = 0 if is_redrawn else n_places
            news = replace(
                known,
                alarms=[alarm.words for alarm in self._stream.alarms],
                is_redrawn=is_redrawn,
                places=[place for place in known.places if place.number > after],
                history=[widths for widths in known.history if is_redrawn or widths.n_readings > n_history],
                silent_s=self._silent_s(),
                pace_s=_pace_s(self._entries),
            )
            return self._drawing, len(self._entries), news

    def _silent_s(self) -> float | None:
        """Time since the journal was last written, however long ago somebody began to watch."""
        if not self._entries:
            return None
        with suppress(OSError):
            return max(0.0, time.time() - self._journal.stat().st_mtime)
        return None

    def _run(self) -> None:
        try:
            while not self._is_left:
                self._wake.clear()
                self._take_diagnosis()
                has_ended = self._follower.has_ended
                entries = self._follower.entries()
                if entries:
                    self._take(entries)
                elif self._stream.can_polish:
                    self._polish(has_ended)
                elif has_ended:
                    break
                else:
                    self._wake.wait(LOOK_EVERY_S)
        except CoilcalError as error:
            self._learn(fault=str(error))
        except FileNotFoundError:
            self._learn(fault="session must be there to be followed; it was deleted")
        except Exception:
            self._learn(fault="estimate must follow the readings; it failed")
            raise
        finally:
            self._learn(has_ended=True)
            self._tell()

    def _polish(self, has_ended: bool) -> None:
        """Do a piece of polishing, or wait a moment until there is time for it; a session that has ended does not wait."""
        if not (has_ended or self._spare.is_left()):
            self._wake.wait(WAIT_S)
        elif self._stream.polish() and self._stream.is_polished:
            self._learn(intervals=self._stream.intervals(), is_polished=True)
            self._tell()

    def _take_diagnosis(self) -> None:
        refreshed, self._refreshed = self._refreshed, None
        if refreshed is None:
            return
        self._stream.improve(refreshed.best)
        causes = list(refreshed.causes)
        self._learn(
            diagnosis=Verdict(refreshed.n_readings, refreshed.verdict, causes, refreshed.took_s),
            intervals=self._stream.intervals(),
            is_polished=self._stream.is_polished,
        )
        self._tell()

    def _take(self, entries: list[Entry]) -> None:
        """Take readings into the estimate, tell of it, and compute old residuals anew where it has moved since."""
        while entries and not self._is_left:
            n = max(FIRST, round((GROWTH - 1.0) * len(self._entries)))
            self._add(entries[:n])
            entries = entries[n:]
            self._tell()
        if len(self._entries) >= REDRAWN_AT * self._n_drawn:
            self._n_drawn = len(self._entries)
            first = max(0, len(self._entries) - MOST_PLACES)
            drawn = self._drawn(self._entries[first:], first)
            with self._lock:
                self._known, self._drawing = replace(self._known, places=drawn), self._drawing + 1
            self._tell()

    def _add(self, entries: list[Entry]) -> None:
        estimate = self._stream.update(observations_of(entries, self._rig))
        new = self._drawn(entries, len(self._entries))
        known, history = self._known, self._known.history
        if estimate.n_readings > HISTORY_STEP * (history[-1].n_readings if history else 0):
            sds = {name: interval.sd for name, interval in estimate.intervals.items()}
            history = [*history, Widths(estimate.n_readings, sds)]
        grown = replace(
            known,
            n_appended=len(self._entries) + len(entries),
            n_readings=estimate.n_readings,
            intervals=dict(estimate.intervals),
            is_polished=estimate.is_polished,
            places=[*known.places, *new][-MOST_PLACES:],
            coils=outlines(self._rig, self._stream.values, observations_of(entries[-1:], self._rig)),
            history=history,
            devices=updated(known.devices, entries, self._rig),
        )
        with self._lock:
            self._entries += entries
            self._known = grown
            wanted = max(FEWEST_READINGS, GROWTH_OF_DIAGNOSIS * self._n_diagnosed)
            if self._waits_since_s is None and len(self._entries) >= wanted:
                self._waits_since_s = time.monotonic()

    def _learn(self, **known: Any) -> None:
        """Note what is known from now on. Only the thread of the session does, so that nothing is lost between."""
        with self._lock:
            self._known = replace(self._known, **known)

    def _drawn(self, entries: list[Entry], n_before: int) -> list[Place]:
        """Places by the present estimate. A stop of several sensors has one number."""
        stops = enumerate(entries, start=n_before + 1)
        numbers = [number for number, entry in stops for _ in entry["field_T"]]
        return places(self._rig, self._stream.values, observations_of(entries, self._rig), numbers)

    def _tell(self) -> None:
        with self._lock:
            watchers = list(self._watchers)
        for loop, event in watchers:
            with suppress(RuntimeError):  # the loop has ended
                loop.call_soon_threadsafe(event.set)


def _pace_s(entries: Sequence[Entry]) -> float | None:
    """Usual time from one reading to the next; None where there are too few to tell."""
    times_s = [float(entry["time_s"]) for entry in entries[-PACED:]]
    return statistics.median(b - a for a, b in pairwise(times_s)) if len(times_s) >= FEWEST_PACED else None


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
        self._diagnosis = RunningDiagnosis(self._all) if is_diagnosed else None

    def start(self) -> None:
        """Begin to diagnose what is watched."""
        if self._diagnosis is not None:
            self._diagnosis.ticker.start()

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
        if self._diagnosis is not None:
            self._diagnosis.ticker.stop()
        with self._lock:
            for watched in self._watched.values():
                watched.leave()
