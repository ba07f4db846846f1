"""Shows how much of something countable is done: a bar on a terminal, plain lines in a pipe; always on standard error."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING

from estimator.cli.output import is_quiet, tell_progress
from estimator.cli.time_left import TimeLeft

if TYPE_CHECKING:
    from rich.progress import Progress

FIRST_AFTER_S = 2.0  # what is done sooner needs no words
LINE_EVERY_S = 10.0  # in a pipe


class CountReporter:
    """Tells of work that lasts longer than two seconds."""

    def __init__(self) -> None:
        self._begin_s = time.monotonic()
        self._printed_s = self._begin_s + FIRST_AFTER_S - LINE_EVERY_S
        self._time_left, self._what = TimeLeft(), ""
        self._bar: Progress | None = None
        if sys.stderr.isatty() and not is_quiet():
            # A pipe needs no library for bars.
            from rich.console import Console
            from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn

            columns = (SpinnerColumn(), TextColumn("{task.description}", markup=False), BarColumn())
            self._bar = Progress(*columns, console=Console(stderr=True), transient=True)
            self._task = self._bar.add_task("", total=None, visible=False)

    def __enter__(self) -> CountReporter:
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def __call__(self, what: str, done: int, total: int) -> None:
        """Show that `done` of `total` are done, such as `predicting points`."""
        if what != self._what:
            self._what, self._time_left = what, TimeLeft()
        words = f"{what}: {done} of {total}{self._time_left.words(float(done), float(total))}"
        now_s = time.monotonic()
        if self._bar is not None:
            is_long = now_s - self._begin_s >= FIRST_AFTER_S
            self._bar.update(self._task, description=words, total=total, completed=done, visible=is_long)
        elif now_s - self._printed_s >= LINE_EVERY_S:
            self._printed_s = now_s
            tell_progress(f"coilcal: {words}")
