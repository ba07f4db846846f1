"""Processor time that a thread may use between readings, so that following a session leaves a computer to others."""

from __future__ import annotations

import time

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
