"""Shows how far a calibration is: a bar on a terminal, plain lines in a pipe; always on standard error."""

from __future__ import annotations

import sys

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from estimator.calibration.calibrate import Stage
from estimator.cli.output import is_quiet, tell_progress
from estimator.cli.time_left import TimeLeft


class StageReporter:
    """Shows each stage of a calibration."""

    def __init__(self) -> None:
        self._last = ""
        self._time_left = TimeLeft()
        console = Console(stderr=True)
        self._bar: Progress | None = None
        # Console.is_terminal also believes FORCE_COLOR, which build servers set while they record a pipe.
        if sys.stderr.isatty() and not is_quiet():
            columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
            self._bar = Progress(*columns, console=console, transient=True)
            self._task = self._bar.add_task("starting", total=None)

    def __enter__(self) -> StageReporter:
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def __call__(self, stage: Stage) -> None:
        """Show one stage."""
        lines = [] if stage.name == self._last else [stage.name]
        self._last = stage.name
        lines += [f"  not determined by the data: {direction.words}" for direction in stage.open_directions]
        sampling = stage.sampling
        detail = ""
        if sampling is not None:
            detail = f"step {sampling.step}, effective samples {sampling.smallest_ess:.0f} of {sampling.target_ess:.0f}"
            detail += f", R-hat {sampling.largest_rhat:.4f}{self._time_left.words(sampling.smallest_ess, sampling.target_ess)}"
        if self._bar is None:
            for line in (*lines, *([f"  {detail}"] if detail else [])):
                tell_progress(line)
            return
        for line in lines:
            self._bar.console.print(line)
        if sampling is not None:
            self._bar.update(
                self._task,
                description=detail,
                total=sampling.target_ess,
                completed=min(sampling.smallest_ess, sampling.target_ess),
            )
        else:
            self._bar.update(self._task, description=stage.name, total=None)
