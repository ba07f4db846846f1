"""Shows how far a diagnosis is: a line with the time left on a terminal, plain lines in a pipe; always on standard error."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, SpinnerColumn, TextColumn
from rich.progress import Progress as Bar

from estimator.calibration.calibrate import Stage
from estimator.cli.output import is_quiet, tell_progress
from estimator.cli.time_left import TimeLeft
from estimator.cli.words import duration_words
from estimator.diagnosis.progress import Progress

LINE_EVERY_S = 30.0  # in a pipe, so that the log of a long search stays short


class SearchReporter:
    """Shows each stage, and within a search what is being fitted."""

    def __init__(self) -> None:
        self._printed_s = time.monotonic()
        self._time_left = TimeLeft()
        self._bar: Bar | None = None
        if sys.stderr.isatty() and not is_quiet():
            columns = (SpinnerColumn(), TextColumn("{task.description}", markup=False), BarColumn())
            self._bar = Bar(*columns, console=Console(stderr=True), transient=True)
            self._task = self._bar.add_task("", total=None)

    def __enter__(self) -> SearchReporter:
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    @contextmanager
    def aside(self) -> Iterator[None]:
        """Leave the terminal to what is printed during the block."""
        if self._bar is None:
            yield
            return
        self._bar.stop()
        try:
            yield
        finally:
            self._bar.start()

    def stage(self, words: str) -> None:
        """Show a message that stays."""
        self._printed_s = time.monotonic()
        if self._bar is None:
            tell_progress(f"coilcal: {words}")
            sys.stderr.flush()
            return
        self._bar.console.print(f"coilcal: {words}", markup=False, highlight=False, soft_wrap=True)
        self._bar.update(self._task, description=words, total=None)

    def sampling(self, stage: Stage) -> None:
        """Show how far the sampling of a posterior is; in a pipe only now and then."""
        sampling = stage.sampling
        if sampling is None:
            if self._bar is not None:
                self._bar.update(self._task, description=stage.name, total=None)
            return
        done, target = min(sampling.smallest_ess, sampling.target_ess), sampling.target_ess
        words = (
            f"{stage.name}: effective samples {done:.0f} of {target:.0f}{self._time_left.words(done, target)}"
        )
        if self._bar is not None:
            self._bar.update(self._task, description=words, total=target, completed=done)
        elif time.monotonic() - self._printed_s >= LINE_EVERY_S:
            self.stage(words)

    def progress(self, progress: Progress) -> None:
        """Show how far a series of fits is; in a pipe only now and then."""
        if self._bar is not None:
            self._bar.update(
                self._task,
                description=progress_words(progress),
                total=progress.most,
                completed=progress.n_fitted,
            )
        elif time.monotonic() - self._printed_s >= LINE_EVERY_S:
            self.stage(progress_words(progress))


def progress_words(progress: Progress) -> str:
    """How far a series of fits is.

    Examples:
        >>> progress_words(Progress("step 2", 7, 16, 20.3))
        'step 2: 7 of up to 16 hypotheses fitted, at most about 20 s of fits left'
        >>> progress_words(Progress("step 2", 4, 4, 0.0))
        'step 2: 4 fitted, comparing all hypotheses'
    """
    if progress.n_fitted == progress.most:
        return f"{progress.what}: {progress.n_fitted} fitted, comparing all hypotheses"
    state = f"{progress.what}: {progress.n_fitted} of up to {progress.most} hypotheses fitted"
    if progress.left_s is None:
        return state
    return f"{state}, at most about {duration_words(progress.left_s)} of fits left"
