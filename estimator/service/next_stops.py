"""Advisers of open sessions: those asked last stay in memory, and follow their session from where they were."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from estimator.planning.next_stop import Adviser, NextStop
from estimator.readings.plan import plan_from_text
from estimator.rig.rig import Rig
from estimator.service.cache import Cache
from estimator.store.journal import read_journal

MOST_ADVISERS = 4  # each holds derivatives of all its candidates


class Question(NamedTuple):
    """What is asked of a session; the same question has the same adviser.

    Attributes:
        session_id: An open session.
        goals: What shall be known.
        places: A plan file to choose from.
        most_stops: After which to end in any case.
        seed: Of all random choices.
    """

    session_id: str
    goals: tuple[str, ...]
    places: str
    most_stops: int
    seed: int


class NextStops:
    """Answers which stop is next, one question at a time.

    Args:
        rig_of: The rig of a session.
        path_of: The folder of a session.
    """

    def __init__(self, rig_of: Callable[[str], Rig], path_of: Callable[[str], Path]) -> None:
        self._rig_of, self._path_of = rig_of, path_of
        self._advisers = Cache(self._adviser, MOST_ADVISERS)
        self._lock = threading.Lock()

    def answer(self, question: Question) -> NextStop:
        """The next stop after the readings that are on disk.

        Raises:
            InvalidInput: A goal or the plan cannot be read, or a goal is out of reach.
        """
        with self._lock:
            _, entries = read_journal(self._path_of(question.session_id))
            return self._advisers[question].after(entries)

    def _adviser(self, question: Question) -> Adviser:
        rig = self._rig_of(question.session_id)
        places = plan_from_text(question.places, rig, "places")
        return Adviser(rig, places, question.goals, None, question.most_stops, question.seed)
