"""Shows the progress of an acquisition: a bar with the time left on a terminal, plain lines in a pipe; always on standard error."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Sequence
from types import TracebackType

import click
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn
from rich.progress import Progress as Bar

from estimator.acquisition.acquire import Progress
from estimator.cli.output import is_quiet, tell_progress
from estimator.cli.words import duration_words

LINE_EVERY_S = 5.0


class StopReporter:
    """Shows each stop."""

    def __init__(self, n_stops: int) -> None:
        self._printed_s = -math.inf
        self._bar: Bar | None = None
        if sys.stderr.isatty() and not is_quiet():
            columns = (
                TextColumn("stop"),
                MofNCompleteColumn(),
                BarColumn(),
                TextColumn("{task.description}"),
            )
            self._bar = Bar(*columns, console=Console(stderr=True), transient=True)
            self._task = self._bar.add_task("", total=n_stops)

    def __enter__(self) -> StopReporter:
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def __call__(self, progress: Progress) -> None:
        """Show one stop."""
        left = f"{duration_words(progress.left_s)} left"
        if self._bar is not None:
            fields = "  ".join(f"{name} {_shown(field)}" for name, field in progress.stop.field_T.items())
            self._bar.update(self._task, completed=progress.n_done, description=f"{left}  {fields}")
            for remark in _remarks(progress):
                self._bar.console.print(remark)
            return
        for remark in _remarks(progress):
            click.echo(remark, err=True)
        now_s = time.monotonic()
        if now_s - self._printed_s >= LINE_EVERY_S or progress.n_done == progress.n_stops:
            tell_progress(f"stop {progress.n_done} of {progress.n_stops}, {left}")
            self._printed_s = now_s


def _shown(field_T: Sequence[float]) -> str:
    return " ".join(f"{1e3 * value_T:+.3f}" for value_T in field_T) + " mT"


def _remarks(progress: Progress) -> list[str]:
    """What went wrong at a stop, which the journal holds too."""
    remarks = [
        f"{name} lost readings at stop {progress.n_done}" for name, n in progress.stop.n_gaps.items() if n
    ]
    if not progress.stop.is_settled:
        remarks.append(f"the field at stop {progress.n_done} had not settled")
    return [f"coilcal: {remark}; it is marked so in the journal" for remark in remarks]
