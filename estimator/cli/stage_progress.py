"""Shows how far a calibration is: a bar on a terminal, plain lines in a pipe; always on standard error."""

from __future__ import annotations

from collections.abc import Sequence

from rich.progress import ProgressColumn, TimeElapsedColumn

from estimator.calibration.calibrate import Stage
from estimator.cli.output import tell_progress
from estimator.cli.progress_bar import BarReporter, spinner_words_bar
from estimator.cli.time_left import TimeLeft


class StageReporter(BarReporter):
    """Shows each stage of a calibration."""

    def __init__(self) -> None:
        self._last = ""
        self._time_left = TimeLeft()
        super().__init__(_columns, "starting", total=None)

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
        if self.bar is None:
            for line in (*lines, *([f"  {detail}"] if detail else [])):
                tell_progress(line)
            return
        for line in lines:
            self.bar.console.print(line)
        if sampling is not None:
            self.update(
                description=detail,
                total=sampling.target_ess,
                completed=min(sampling.smallest_ess, sampling.target_ess),
            )
        else:
            self.update(description=stage.name, total=None)


def _columns() -> Sequence[ProgressColumn]:
    return *spinner_words_bar(), TimeElapsedColumn()
