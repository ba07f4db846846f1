"""Shows how far a diagnosis is: a line with the time left on a terminal, plain lines in a pipe; always on standard error."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

from estimator.calibration.calibrate import Stage
from estimator.cli.output import tell_progress
from estimator.cli.progress_bar import BarReporter, spinner_words_bar
from estimator.cli.time_left import TimeLeft
from estimator.cli.words import duration_words
from estimator.diagnosis.progress import Progress

LINE_EVERY_S = 30.0  # in a pipe, so that the log of a long search stays short


class SearchReporter(BarReporter):
    """Shows each stage, and within a search what is being fitted."""

    def __init__(self) -> None:
        self._printed_s = time.monotonic()
        self._time_left = TimeLeft()
        super().__init__(spinner_words_bar, total=None)

    @contextmanager
    def aside(self) -> Iterator[None]:
        """Leave the terminal to what is printed during the block."""
        self.stop()
        try:
            yield
        finally:
            self.start()

    def stage(self, words: str) -> None:
        """Show a message that stays."""
        self._printed_s = time.monotonic()
        if self.bar is None:
            tell_progress(f"coilcal: {words}")
            sys.stderr.flush()
            return
        self.bar.console.print(f"coilcal: {words}", markup=False, highlight=False, soft_wrap=True)
        self.update(description=words, total=None)

    def sampling(self, stage: Stage) -> None:
        """Show how far the sampling of a posterior is; in a pipe only now and then."""
        sampling = stage.sampling
        if sampling is None:
            self.update(description=stage.name, total=None)
            return
        done, target = min(sampling.smallest_ess, sampling.target_ess), sampling.target_ess
        words = (
            f"{stage.name}: effective samples {done:.0f} of {target:.0f}{self._time_left.words(done, target)}"
        )
        self.update(description=words, total=target, completed=done)
        if self.bar is None and time.monotonic() - self._printed_s >= LINE_EVERY_S:
            self.stage(words)

    def progress(self, progress: Progress) -> None:
        """Show how far a series of fits is; in a pipe only now and then."""
        words = progress_words(progress)
        self.update(description=words, total=progress.most, completed=progress.n_fitted)
        if self.bar is None and time.monotonic() - self._printed_s >= LINE_EVERY_S:
            self.stage(words)


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
