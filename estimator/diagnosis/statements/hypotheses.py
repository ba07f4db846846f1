"""The hypotheses that were compared in the place of each stated cause, and beside all that leads."""

from __future__ import annotations

from collections.abc import Iterator

from estimator.diagnosis.mixture.comparison import NOTHING, Comparison, Hypothesis, credible
from estimator.diagnosis.panel_records import Race, Runner
from estimator.diagnosis.result import Diagnosis
from estimator.effects import EFFECTS
from estimator.reporting.numbers import percent
from estimator.reporting.page import Table

MOST_COMPARISONS, MOST_ROWS, MOST_RUNNERS = 6, 8, 12


def hypotheses_tables(diagnosis: Diagnosis) -> Iterator[Table]:
    """Each comparison with its most probable hypotheses; `nothing` and `unexplained` are always listed."""
    for number, (title, comparison) in enumerate(diagnosis.comparisons[:MOST_COMPARISONS], start=1):
        listed = [h for i, h in enumerate(comparison.hypotheses) if i < MOST_ROWS or h.cause is None]
        yield Table(
            f"Hypotheses, comparison {number}: {title}",
            ["hypothesis", "meaning", "log Bayes factor", "probability", "outcome"],
            [
                [
                    diagnosis.label_of_hypothesis(hypothesis),
                    _meaning(hypothesis),
                    f"{round(hypothesis.log_bayes_factor, 1) + 0.0:.1f}".replace("-", "−"),
                    percent(hypothesis.probability, 1) if hypothesis.probability > 1e-3 else "< 0.1 %",
                    _outcome(comparison, hypothesis),
                ]
                for hypothesis in listed
            ],
            "Log Bayes factors are against nothing wrong, beside all other causes and departures that lead, by the readings that were "
            "asked.",
        )


def _meaning(hypothesis: Hypothesis) -> str:
    if hypothesis.cause is not None:
        return EFFECTS[hypothesis.cause.name].words
    return "nothing wrong" if hypothesis.name == NOTHING else "a departure that no list holds"


def _outcome(comparison: Comparison, hypothesis: Hypothesis) -> str:
    if hypothesis.cause in comparison.taken:
        return "stated"
    if comparison.taken and hypothesis in credible(comparison.hypotheses):
        return "cannot be told apart from what was stated"
    return "" if hypothesis.cause is None else "not needed"


def races(diagnosis: Diagnosis) -> list[Race]:
    """Each comparison as the page of the service shows it, by log Bayes factor."""
    return [
        _race(diagnosis, title, comparison) for title, comparison in diagnosis.comparisons[:MOST_COMPARISONS]
    ]


def _race(diagnosis: Diagnosis, title: str, comparison: Comparison) -> Race:
    ranked = sorted(comparison.hypotheses, key=lambda h: -h.log_bayes_factor)
    listed = [h for i, h in enumerate(ranked) if i < MOST_RUNNERS or h.cause is None]
    runners = [_runner(diagnosis, comparison, hypothesis) for hypothesis in listed]
    return Race(title if comparison.taken else "", runners)


def _runner(diagnosis: Diagnosis, comparison: Comparison, hypothesis: Hypothesis) -> Runner:
    cause, role = hypothesis.cause, "other"
    if cause in {named.cause for named in diagnosis.causes}:
        role = "named"
    elif comparison.taken and hypothesis in credible(comparison.hypotheses):
        role = "alternative"
    elif cause in diagnosis.findings.stand_ins:
        role = "stand-in"
    item = comparison.best_departure if cause is None else comparison.best_item(cause)
    return Runner(
        diagnosis.label_of_hypothesis(hypothesis),
        _meaning(hypothesis),
        hypothesis.log_bayes_factor,
        role,
        comparison.left_sigma(None if hypothesis.name == NOTHING else item),
    )
