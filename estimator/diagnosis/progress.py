"""How far a diagnosis is while it asks the readings again and again."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Progress:
    """State of a series of questions to the readings.

    Attributes:
        what: What is asked.
        n_fitted: Questions that were answered.
        most: Questions at most.
        left_s: Time that they will take at most, at their mean pace so far; None before the first.
    """

    what: str
    n_fitted: int
    most: int
    left_s: float | None


OnProgress = Callable[[Progress], None]
OnCount = Callable[[str, int, int], None]
"""Called with what is being done, how many of it are done, and how many there are."""


def unwatched(progress: Progress) -> None:
    """Ignore the progress of a diagnosis that nobody watches."""


def uncounted(what: str, done: int, total: int) -> None:
    """Ignore how far work is that nobody watches."""


class Pace:
    """Tells after each question of a series how far it is.

    Args:
        what: What is asked.
        on_progress: Called with the state.
    """

    def __init__(self, what: str, on_progress: OnProgress) -> None:
        self.what, self.on_progress = what, on_progress
        self.begin_s = time.monotonic()

    def tell(self, n_fitted: int, most: int) -> None:
        """Tell how many questions were answered, and how many there will be at most."""
        mean_s = (time.monotonic() - self.begin_s) / n_fitted if n_fitted else None
        left_s = None if mean_s is None else mean_s * (most - n_fitted)
        self.on_progress(Progress(self.what, n_fitted, most, left_s))
