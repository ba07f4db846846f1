"""Diagnoses sessions while they are watched and grow, one after another in one process of low priority.

A diagnosis takes as long as hundreds of estimates, so it must not hold them up, and a process for each session would fill the memory. It
is no job: it starts by itself, and nothing is stored of it.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence

from estimator.errors import CoilcalError
from estimator.live.refresh import Background
from estimator.service.watched import Watched

LOOK_EVERY_S = 0.25
SEED = 0
log = logging.getLogger("coilcal.service")


class RunningDiagnosis:
    """Gives the process its work, which lives while sessions are watched."""

    def __init__(self) -> None:
        self._background: Background | None = None
        self._at: Watched | None = None

    def look(self, sessions: Sequence[Watched]) -> None:
        """Take what is done, and begin with the session that waits longest.

        Args:
            sessions: Those that are watched now. Without any, or where the one at work is left, the process ends whatever it does.
        """
        if not sessions or (self._at is not None and self._at.is_left):
            self.stop()
        if self._at is not None and self._background is not None:
            if (refreshed := self._background.take()) is not None:
                self._at.take(refreshed)
                log.info("running diagnosis", extra={"took_s": round(refreshed.took_s, 1)})
            elif not self._background.is_busy and self._background.trouble is not None:
                log.warning("running diagnosis failed", extra={"fault": self._background.trouble})
            self._at = self._at if self._background.is_busy else None
        if self._at is None:
            self._begin(sessions)

    def _begin(self, sessions: Sequence[Watched]) -> None:
        waiting = {
            session: since_s
            for session in sessions
            if (since_s := session.waits_since_s) is not None and not session.is_left
        }
        if not waiting:
            return
        first = min(waiting, key=lambda session: waiting[session])
        try:
            readings = first.so_far()
        except CoilcalError:
            return  # readings that no session holds: the estimate of the session says why
        self._background = self._background or Background(SEED)
        self._background.begin(readings)
        self._at = first

    def stop(self) -> None:
        """End the process."""
        if self._background is not None:
            self._background.__exit__()
        self._background = self._at = None
