"""Follows a session while another process writes it: estimate and alarms after new readings, polishing while there are none.

`coilcal live` shows its state on a terminal, and the service sends it to its watchers.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from enum import Enum, auto
from pathlib import Path

from estimator.live.stream import Estimate, Stream
from estimator.store.follow import Follower
from estimator.store.growing import observations_of
from estimator.store.journal import Entry
from estimator.store.session import Session

SHARE = 0.17  # of a core, for all that the thread does; `coilcal live` may take 20 %, and its screen is drawn by another thread
MOST_S = 0.1  # of a core that idle time saves up, or that updates take in advance
WAIT_S = 0.02  # until there may be time again


class ProcessorShare:
    """Whether the thread that asks has used less than its share of a core; all its work counts."""

    def __init__(self) -> None:
        self._credit_s = MOST_S
        self._now_s, self._used_s = time.monotonic(), time.thread_time()

    def is_left(self) -> bool:
        """Whether there is time for a short piece of work."""
        now_s, used_s = time.monotonic(), time.thread_time()
        earned_s = SHARE * (now_s - self._now_s) - (used_s - self._used_s)
        self._credit_s = max(-MOST_S, min(MOST_S, self._credit_s + earned_s))
        self._now_s, self._used_s = now_s, used_s
        return self._credit_s > 0.0


# Readings that were there before are taken in growing parts, so that the intervals have a past and alarms can be raised.
FIRST, GROWTH = 10, 1.6


class Step(Enum):
    """What a step of the engine did."""

    READINGS = auto()  # took new readings
    POLISHED = auto()  # reached the estimate of a batch fit
    WORKED = auto()  # came nearer to it
    IDLE = auto()  # nothing, since there is nothing to do yet
    ENDED = auto()  # nothing, since the session has ended


class LiveEngine:
    """The estimate of a session that grows.

    Args:
        path: Folder of the session.
    Attributes:
        rig: The rig that is measured.
        header: First entry of the journal.
        stream: The running calibration.
        entries: Entries of the journal that were taken so far.
        n_new: How many of them the last step took.
        estimate: Latest estimate; None before the first reading.
    Raises:
        InvalidInput: There is no such session, or its rig has no free parameter.
    """

    def __init__(self, path: Path) -> None:
        self._follower = Follower(path)
        self.rig, self.header = self._follower.rig, self._follower.header
        self.stream, self._share = Stream(self.rig), ProcessorShare()
        self.entries: list[Entry] = []
        self.n_new = 0
        self.estimate: Estimate | None = None
        self._untaken: list[Entry] = []

    def step(self) -> Step:
        """Take new readings, or else do a short piece of polishing if the thread has used less than its share of the processor.

        Raises:
            CoilcalError: The readings cannot be followed.
        """
        has_ended = self._follower.has_ended  # asked before the journal is read, so that no reading is missed
        self._untaken += self._follower.entries()
        self.n_new = min(len(self._untaken), max(FIRST, round((GROWTH - 1.0) * len(self.entries))))
        if self._untaken:
            new = self._untaken[: self.n_new]
            self.estimate = self.stream.update(observations_of(new, self.rig))
            self.entries += new
            del self._untaken[: self.n_new]
            return Step.READINGS
        if self.stream.can_polish and (has_ended or self._share.is_left()):
            if self.stream.polish() and self.stream.is_polished:
                self._renew()
                return Step.POLISHED
            return Step.WORKED
        return Step.ENDED if has_ended else Step.IDLE

    @property
    def has_more(self) -> bool:
        """Whether readings are known that no step has taken yet."""
        return bool(self._untaken)

    def improve(self, best: Mapping[str, float]) -> None:
        """Go on from the optimum of a diagnosis where that is better."""
        self.stream.improve(best)
        self._renew()

    def session(self) -> Session:
        """The readings that were taken so far."""
        entries = list(self.entries)
        return Session(self.rig, observations_of(entries, self.rig), str(self.header["source"]))

    def _renew(self) -> None:
        """Tell where the estimate has moved to without a new reading."""
        if self.estimate is not None:
            intervals, is_polished = self.stream.intervals(), self.stream.is_polished
            self.estimate = replace(self.estimate, intervals=intervals, is_polished=is_polished)
