"""Shows the progress of an acquisition: a bar with the time left on a terminal, plain lines in a pipe; always on standard error."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence

import click
from rich.progress import BarColumn, MofNCompleteColumn, ProgressColumn, TextColumn

from estimator.acquisition.acquire import Progress
from estimator.cli.output import tell_progress
from estimator.cli.progress_bar import BarReporter
from estimator.cli.words import duration_words

LINE_EVERY_S = 5.0


class StopReporter(BarReporter):
    """Shows each stop."""

    def __init__(self, n_stops: int) -> None:
        self._printed_s = -math.inf
        super().__init__(_columns, total=n_stops)

    def __call__(self, progress: Progress) -> None:
        """Show one stop."""
        left = f"{duration_words(progress.left_s)} left"
        if self.bar is not None:
            fields = "  ".join(f"{name} {_shown(field)}" for name, field in progress.stop.field_T.items())
            self.update(completed=progress.n_done, description=f"{left}  {fields}")
            for remark in _remarks(progress):
                self.bar.console.print(remark)
            return
        for remark in _remarks(progress):
            click.echo(remark, err=True)
        now_s = time.monotonic()
        if now_s - self._printed_s >= LINE_EVERY_S or progress.n_done == progress.n_stops:
            tell_progress(f"stop {progress.n_done} of {progress.n_stops}, {left}")
            self._printed_s = now_s


def _columns() -> Sequence[ProgressColumn]:
    return TextColumn("stop"), MofNCompleteColumn(), BarColumn(), TextColumn("{task.description}")


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
