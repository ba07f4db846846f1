"""Functions that get the progress of a recalibration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from estimator.calibration.calibrate import Stage
from estimator.diagnosis.progress import OnProgress, unwatched


def ignored(_: object) -> None:
    """Ignore what nobody watches."""


@dataclass(frozen=True)
class Watcher:
    """Functions that are called while sessions are judged, which may take minutes each.

    Attributes:
        on_words: With each step, in words.
        on_progress: As a diagnosis fits hypotheses.
        on_sampling: With each stage of sampling a new version.
    """

    on_words: Callable[[str], None] = ignored
    on_progress: OnProgress = unwatched
    on_sampling: Callable[[Stage], None] = ignored


UNWATCHED = Watcher()
