"""What recalibration concludes from one session, and its causes in the words of the log."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from estimator.calibration.result import Calibration
from estimator.diagnosis.result import Diagnosis
from estimator.diagnosis.sizes import Interval, SizedCause
from estimator.diagnosis.validation import Improvement
from estimator.readings.flags import told

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


def names_of(diagnosis: Diagnosis) -> str:
    """Names of the causes."""
    return " and ".join(cause.name for cause in diagnosis.sized_causes)


def mistake_in(diagnosis: Diagnosis) -> str:
    """Mistakes of the record with their sizes, and readings that are not as they were measured."""
    flagged = told(diagnosis.findings.flags, diagnosis.sensor_names).rstrip(".")
    mistakes = f"a mistake of the record: {sizes_of(diagnosis)}" if diagnosis.record_mistakes else ""
    return "; ".join(words for words in (mistakes, flagged) if words)


def sizes_of(diagnosis: Diagnosis) -> str:
    """Causes with the sizes of their quantities."""
    return " and ".join(_size(cause) for cause in diagnosis.sized_causes)


def _size(cause: SizedCause) -> str:
    sizes = [_quantity(f"{cause.name}.{key}", interval) for key, interval in cause.quantities.items()]
    alternatives = "".join(f" or {name}" for name, _ in cause.others)
    return f"{cause.name}{alternatives} ({', '.join(sizes)})"


def _quantity(name: str, interval: Interval) -> str:
    """A quantity in its display unit."""
    show, value, sd = interval.display(name), interval.median, interval.sd
    size = show.with_sd(value, sd) if sd else f"{value * show.factor:.4g}"
    return f"{show.words} {size} {show.unit}".rstrip()


def words_of(improvement: Improvement) -> str:
    """Whether a new fit predicts unseen readings better, with the numbers."""
    words = (
        "predicts unseen readings better"
        if improvement.is_significant
        else "does not predict unseen readings better"
    )
    return f"the new fit {words} than the current version (log density {improvement.elpd_difference:+.1f} ± {improvement.elpd_se:.1f})"
