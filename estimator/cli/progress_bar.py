"""A bar for those who wait at a terminal; in a pipe there is none, and a reporter prints lines. Both go to standard error."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

from estimator.cli.output import is_quiet

if TYPE_CHECKING:
    from rich.progress import Progress, ProgressColumn

Reporter = TypeVar("Reporter", bound="BarReporter")


class BarReporter:
    """Shows a bar while it lasts, where standard error is a terminal.

    Rich's own question, `Console.is_terminal`, also believes FORCE_COLOR, which build servers set while they record a pipe.

    Args:
        columns: Makes the columns of the bar; a pipe needs no library for them.
        words: First description of the task.
        options: Of the task, as `rich.progress.Progress.add_task` takes them.
    """

    def __init__(
        self, columns: Callable[[], Sequence[ProgressColumn]], words: str = "", **options: Any
    ) -> None:
        self.bar: Progress | None = None
        if sys.stderr.isatty() and not is_quiet():
            from rich.console import Console
            from rich.progress import Progress

            self.bar = Progress(*columns(), console=Console(stderr=True), transient=True)
            self._task = self.bar.add_task(words, **options)

    def __enter__(self: Reporter) -> Reporter:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(self) -> None:
        """Show the bar."""
        if self.bar is not None:
            self.bar.start()

    def stop(self) -> None:
        """Take it away."""
        if self.bar is not None:
            self.bar.stop()

    def update(self, **options: Any) -> None:
        """Show how far the task is; nothing where there is no bar."""
        if self.bar is not None:
            self.bar.update(self._task, **options)


def spinner_words_bar() -> Sequence[ProgressColumn]:
    """Columns of most bars; words may hold square brackets."""
    from rich.progress import BarColumn, SpinnerColumn, TextColumn

    return SpinnerColumn(), TextColumn("{task.description}", markup=False), BarColumn()
