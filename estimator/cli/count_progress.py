"""Shows how much of something countable is done: a bar on a terminal, plain lines in a pipe; always on standard error."""

from __future__ import annotations

import time

from estimator.cli.output import tell_progress
from estimator.cli.progress_bar import BarReporter, spinner_words_bar
from estimator.cli.time_left import TimeLeft

FIRST_AFTER_S = 2.0  # what is done sooner needs no words
LINE_EVERY_S = 10.0  # in a pipe


class CountReporter(BarReporter):
    """Tells of work that lasts longer than two seconds."""

    def __init__(self) -> None:
        self._begin_s = time.monotonic()
        self._printed_s = self._begin_s + FIRST_AFTER_S - LINE_EVERY_S
        self._time_left, self._what = TimeLeft(), ""
        super().__init__(spinner_words_bar, total=None, visible=False)

    def __call__(self, what: str, done: int, total: int) -> None:
        """Show that `done` of `total` are done, such as `predicting points`."""
        if what != self._what:
            self._what, self._time_left = what, TimeLeft()
        words = f"{what}: {done} of {total}{self._time_left.words(float(done), float(total))}"
        now_s = time.monotonic()
        is_long = now_s - self._begin_s >= FIRST_AFTER_S
        self.update(description=words, total=total, completed=done, visible=is_long)
        if self.bar is None and now_s - self._printed_s >= LINE_EVERY_S:
            self._printed_s = now_s
            tell_progress(f"coilcal: {words}")
