"""Functions that get the progress of a recalibration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from estimator.calibration.calibrate import Stage
from estimator.diagnosis.progress import OnProgress, unwatched


def _ignored(_: object) -> None:
    pass


@dataclass(frozen=True)
class Watcher:
    """Functions that are called while sessions are judged, which may take minutes each.

    Attributes:
        on_words: With each step, in words.
        on_progress: As a diagnosis fits hypotheses.
        on_sampling: With each stage of sampling a new version.
    """

    on_words: Callable[[str], None] = field(default_factory=lambda: _ignored)
    on_progress: OnProgress = field(default_factory=lambda: unwatched)
    on_sampling: Callable[[Stage], None] = field(default_factory=lambda: _ignored)


UNWATCHED = Watcher()
