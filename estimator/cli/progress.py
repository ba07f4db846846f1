"""How far a command is, on standard error: a bar on a terminal, lines at intervals in a pipe, nothing with `--quiet`."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from math import inf
from typing import TYPE_CHECKING

import click

from estimator.cli.output import is_quiet, tell_progress
from estimator.cli.words import duration_words

if TYPE_CHECKING:
    import rich.progress

    from estimator.acquisition.acquire import Progress as Visits
    from estimator.calibration.calibrate import Stage
    from estimator.diagnosis.progress import Progress as Fits
    from estimator.inference.ensemble import Progress as Sampled

LINE_EVERY_S = 30.0  # of a search in a pipe, so that its log stays short
COUNTED_EVERY_S, UNTOLD_S = 10.0, 2.0  # of work that can be counted; what is done sooner needs no words
LEAST_S = 1.0  # below which no time left is told


class Reporter:
    """Shows how far work is, as long as the `with` block lasts.

    Rich's own question, `Console.is_terminal`, also believes FORCE_COLOR, which build servers set while they record a pipe.

    Args:
        every_s: Time between two lines in a pipe.
        first_s: Time until the first of them.
        hidden_s: Time until the bar is shown.
    Attributes:
        bar: The bar; None where there is none.
    """

    def __init__(self, every_s: float = 0.0, first_s: float = 0.0, hidden_s: float = 0.0) -> None:
        self._begin_s, self._every_s, self._hidden_s = time.monotonic(), every_s, hidden_s
        self._printed_s = self._begin_s + first_s - every_s
        self._what, self._time_left, self._steps_left = "", TimeLeft(), TimeLeft()
        self.bar: rich.progress.Progress | None = None
        if sys.stderr.isatty() and not is_quiet():
            from rich.console import Console
            from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn

            words = TextColumn("{task.description}", markup=False)  # which may hold square brackets
            self.bar = Progress(
                SpinnerColumn(), words, BarColumn(), console=Console(stderr=True), transient=True
            )
            self._task = self.bar.add_task("", total=None, visible=not hidden_s)

    def __enter__(self) -> Reporter:
        if self.bar is not None:
            self.bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self.bar is not None:
            self.bar.stop()

    @contextmanager
    def aside(self) -> Iterator[None]:
        """Leave the terminal to what is printed during the block."""
        self.__exit__()
        try:
            yield
        finally:
            self.__enter__()

    def say(self, line: str) -> None:
        """Show a line that stays."""
        self._printed_s = time.monotonic()
        if self.bar is None:
            tell_progress(line)
            sys.stderr.flush()
        else:
            self.bar.console.print(line, markup=False, highlight=False, soft_wrap=True)

    def show(
        self, words: str, done: float = 0.0, total: float | None = None, line: str | None = None
    ) -> None:
        """Show how far the work is.

        Args:
            words: Beside the bar.
            done, total: Length of the bar; without a total it only moves.
            line: What a pipe gets once the interval is over; nothing by default.
        """
        now_s = time.monotonic()
        if self.bar is not None:
            is_visible = now_s - self._begin_s >= self._hidden_s
            self.bar.update(self._task, description=words, completed=done, total=total, visible=is_visible)
        elif line is not None and now_s - self._printed_s >= self._every_s:
            self.say(line)

    def calibration(self, stage: Stage) -> None:
        """Show a stage of a calibration."""
        if stage.name != self._what:
            self._what = stage.name
            self.say(stage.name)
        if stage.open_directions:
            from estimator.calibration.notes import undetermined_lines

            for line in undetermined_lines([vars(direction) for direction in stage.open_directions]):
                self.say(f"  {line}")
        sampling = stage.sampling
        if sampling is None:
            self.show(stage.name)
            return
        done, target = sampling.smallest_ess, sampling.target_ess
        words = f"step {sampling.step}, effective samples {done:.0f} of {target:.0f}"
        words += f", R-hat {sampling.largest_rhat:.4f}{self._sampling_left(sampling)}"
        self.show(words, min(done, target), target, f"  {words}")

    def stage(self, words: str) -> None:
        """Show a stage of a diagnosis or a recalibration."""
        self.say(f"coilcal: {words}")
        self.show(words)

    def sampling(self, stage: Stage) -> None:
        """Show how far the sampling of a new version is."""
        if stage.sampling is None:
            self.show(stage.name)
            return
        target = stage.sampling.target_ess
        done = min(stage.sampling.smallest_ess, target)
        left = self._sampling_left(stage.sampling)
        words = f"{stage.name}: effective samples {done:.0f} of {target:.0f}{left}"
        self.show(words, done, target, f"coilcal: {words}")

    def _sampling_left(self, sampling: Sampled) -> str:
        """The time left until there are enough effective samples or no more steps, whichever comes first."""
        samples_s = self._time_left.seconds(sampling.smallest_ess, sampling.target_ess)
        return left_words(min(samples_s, self._steps_left.seconds(sampling.step, sampling.max_steps)))

    def fits(self, progress: Fits) -> None:
        """Show how far a series of fits is."""
        words = fits_words(progress)
        self.show(words, progress.n_fitted, progress.most, f"coilcal: {words}")

    def count(self, what: str, done: int, total: int) -> None:
        """Show that `done` of `total` are done, such as `predicting points`."""
        if what != self._what:
            self._what, self._time_left = what, TimeLeft()
        words = f"{what}: {done} of {total}{left_words(self._time_left.seconds(done, total))}"
        self.show(words, done, total, f"coilcal: {words}")

    def visits(self, progress: Visits) -> None:
        """Show a stop of a measurement; what went wrong there is told even where progress is not."""
        done, total, stop = progress.n_done, progress.n_stops, progress.stop
        remarks = [f"{name} lost readings at stop {done}" for name, n in stop.n_gaps.items() if n]
        remarks += [] if stop.is_settled else [f"the field at stop {done} had not settled"]
        for remark in remarks:
            line = f"coilcal: {remark}; it is marked so in the journal"
            click.echo(line, err=True) if self.bar is None else self.say(line)
        words = f"stop {done} of {total}, {duration_words(progress.left_s)} left"
        if done == total:
            self._printed_s = self._begin_s - self._every_s  # the last one is told whenever it comes
        fields = [
            f"{name} {' '.join(f'{1e3 * value_T:+.3f}' for value_T in field_T)} mT"
            for name, field_T in stop.field_T.items()
        ]
        self.show("  ".join([words, *fields]), done, total, words)


class TimeLeft:
    """Remembers when work began, and how much was done by then."""

    def __init__(self) -> None:
        self._began: tuple[float, float] | None = None

    def seconds(self, done: float, target: float) -> float:
        """The time left if the work goes on as it has, in seconds; infinite while that is unknown, 0 at the end.

        Args:
            done: How much is done by now; where it falls, something new has begun.
            target: How much there is to do.
        """
        now_s = time.monotonic()
        if self._began is None or done < self._began[1]:
            self._began = now_s, done
        begin_s, done_before = self._began
        if done >= target:
            return 0.0
        return (target - done) * (now_s - begin_s) / (done - done_before) if done > done_before else inf


def left_words(left_s: float) -> str:
    """The time left as the end of a line; nothing where it is short or unknown."""
    return f", about {duration_words(left_s)} left" if LEAST_S <= left_s < inf else ""


def fits_words(progress: Fits) -> str:
    """How far a series of fits is.

    Examples:
        >>> from estimator.diagnosis.progress import Progress
        >>> fits_words(Progress("step 2", 7, 16, 20.3))
        'step 2: 7 of up to 16 hypotheses fitted, at most about 20 s of fits left'
        >>> fits_words(Progress("step 2", 4, 4, 0.0))
        'step 2: 4 fitted, comparing all hypotheses'
    """
    if progress.n_fitted == progress.most:
        return f"{progress.what}: {progress.n_fitted} fitted, comparing all hypotheses"
    state = f"{progress.what}: {progress.n_fitted} of up to {progress.most} hypotheses fitted"
    if progress.left_s is None:
        return state
    return f"{state}, at most about {duration_words(progress.left_s)} of fits left"
