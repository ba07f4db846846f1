"""About how long something will take that goes on as it has since it began."""

from __future__ import annotations

import time

from estimator.cli.words import duration_words

LEAST_S = 1.0  # below which no time is told


class TimeLeft:
    """Remembers when something began, and how much was done by then."""

    def __init__(self) -> None:
        self._began: tuple[float, float] | None = None

    def words(self, done: float, target: float) -> str:
        """The time left, as the end of a line; nothing at the beginning and at the end.

        Args:
            done: How much is done by now; where it falls, something new has begun.
            target: How much there is to do.
        """
        now_s = time.monotonic()
        if self._began is None or done < self._began[1]:
            self._began = now_s, done
        begin_s, done_before = self._began
        if not done_before < done < target:
            return ""
        left_s = (target - done) * (now_s - begin_s) / (done - done_before)
        return f", about {duration_words(left_s)} left" if left_s >= LEAST_S else ""
