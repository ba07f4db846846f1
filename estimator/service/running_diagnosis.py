"""Diagnoses sessions while they are watched and grow, one after another in one process of low priority.

A diagnosis takes as long as hundreds of estimates, so it must not hold them up, and a process for each session would fill the memory. It
is no job: it starts by itself, and nothing is stored of it.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Sequence

from estimator.errors import CoilcalError
from estimator.live.refresh import Background
from estimator.service.watched import Watched

LOOK_EVERY_S = 0.25
SEED = 0
log = logging.getLogger("coilcal.service")


class RunningDiagnosis:
    """Gives the process its work, which lives while sessions are watched.

    Args:
        sessions: Those that are watched now.
    Attributes:
        stopping: Setting it ends the process, whatever that does.
    """

    def __init__(self, sessions: Callable[[], Sequence[Watched]]) -> None:
        self._sessions, self.stopping = sessions, threading.Event()

    def look(self) -> None:
        """Start the process where a session waits, and let it work while sessions are watched."""
        if self._next() is not None:
            with Background(SEED) as background:
                while self._sessions() and self._turn(background):
                    pass

    def _next(self) -> Watched | None:
        """The session that waits longest."""
        waiting = [
            (since_s, session)
            for session in self._sessions()
            if (since_s := session.waits_since_s) is not None and not session.is_left
        ]
        return min(waiting, key=lambda pair: pair[0])[1] if waiting else None

    def _turn(self, background: Background) -> bool:
        """Diagnose one session, if one waits; False if the process works on a session that is no longer watched."""
        session = self._next()
        if session is None:
            self.stopping.wait(LOOK_EVERY_S)
            return not self.stopping.is_set()
        begin_s = time.monotonic()
        try:
            background.begin(session.so_far())
        except CoilcalError:
            return True  # readings that no session holds: the estimate of the session says why
        while background.is_busy:
            refreshed = background.take()
            if refreshed is not None:
                session.take(refreshed)
                log.info("running diagnosis", extra={"took_s": round(time.monotonic() - begin_s, 1)})
            elif self.stopping.is_set() or session.is_left:
                return False
            elif background.is_busy:
                self.stopping.wait(LOOK_EVERY_S)
        if background.trouble is not None:
            log.warning("running diagnosis failed", extra={"fault": background.trouble})
        return True
