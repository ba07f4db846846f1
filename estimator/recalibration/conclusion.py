"""What recalibration concludes from one session."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from estimator.calibration.result import Calibration

EVIDENCE = "log_bayes_factors"  # among the checks of a session that was diagnosed
IS_CONVERGED = "is_successor_converged"  # among the checks of a session that was sampled


class Conclusion(StrEnum):
    """Outcome of one session; the words are stable."""

    UNCHANGED = "unchanged"
    UPDATED = "updated"
    DRIFTED = "drifted"
    REJECTED = "rejected"


@dataclass(frozen=True)
class Judgement:
    """Conclusion on a session, with its reason and numbers.

    Attributes:
        conclusion: One of four.
        reason: Reason in one sentence, with the numbers.
        calibration: Replaces the current one; None if that stays.
        agrees: Whether the session agrees with the current version; None if they could not be compared.
        causes: Causes of a drift, or mistakes of the record, as in `diagnosis.json`.
        checks: Numbers behind the conclusion.
        estimate: Value and standard deviation of every parameter from this session within the widened prior.
    """

    conclusion: Conclusion
    reason: str
    calibration: Calibration | None = None
    agrees: bool | None = None
    causes: tuple[Mapping[str, Any], ...] = ()
    checks: Mapping[str, Any] = field(default_factory=dict)
    estimate: Mapping[str, tuple[float, float]] = field(default_factory=dict)
