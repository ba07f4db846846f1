"""The hypotheses that were compared in the place of each stated cause, and beside all that leads."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from estimator.diagnosis.mixture.comparison import NOTHING, Comparison, Hypothesis
from estimator.diagnosis.panel_records import Race, Runner
from estimator.diagnosis.result import Diagnosis
from estimator.effects import EFFECTS
from estimator.reporting.numbers import percent
from estimator.reporting.page import Table
from estimator.reporting.roles import Role
from estimator.rig.rig import Cause

MOST_COMPARISONS, MOST_ROWS, MOST_RUNNERS = 6, 8, 12
OUTCOME = {Role.NAMED: "stated", Role.ALTERNATIVE: "cannot be told apart from what was stated"}


def hypotheses_tables(diagnosis: Diagnosis) -> Iterator[Table]:
    """Each comparison with its most probable hypotheses."""
    for number, (title, comparison) in enumerate(diagnosis.comparisons[:MOST_COMPARISONS], start=1):
        listed = _listed(comparison.hypotheses, MOST_ROWS, comparison.taken)
        yield Table(
            f"Hypotheses, comparison {number}: {title}",
            ["hypothesis", "meaning", "log Bayes factor", "probability", "outcome"],
            [
                [
                    diagnosis.label_of_hypothesis(h),
                    _meaning(h),
                    f"{round(h.log_bayes_factor, 1) + 0.0:.1f}".replace("-", "−"),
                    percent(h.probability, 1) if h.probability > 1e-3 else "< 0.1 %",
                    _outcome(diagnosis, h, comparison.taken),
                ]
                for h in listed
            ],
            "Log Bayes factors are over “nothing wrong”, with all other leading causes and departures in the model. Probabilities add how "
            "common each hypothesis is, but neither halves of the readings nor imitations, which count in those of the verdict.",
        )


def _listed(ranked: Sequence[Hypothesis], most: int, taken: Sequence[Cause]) -> list[Hypothesis]:
    """The first hypotheses, and beyond them what was stated, `nothing` and `unexplained`."""
    return [h for i, h in enumerate(ranked) if i < most or h.cause is None or h.cause in taken]


def _meaning(hypothesis: Hypothesis) -> str:
    if hypothesis.cause is not None:
        return EFFECTS[hypothesis.cause.name].words
    return "nothing wrong" if hypothesis.name == NOTHING else "a departure that no list holds"


def _outcome(diagnosis: Diagnosis, hypothesis: Hypothesis, taken: Sequence[Cause]) -> str:
    role = role_of(diagnosis, hypothesis.cause, taken)
    return "" if hypothesis.cause is None else OUTCOME.get(role, str(role))


def role_of(diagnosis: Diagnosis, cause: Cause | None, taken: Sequence[Cause] = ()) -> Role:
    """What the verdict makes of a cause.

    Args:
        diagnosis: With the verdict.
        cause: The cause; None for a hypothesis without one.
        taken: Stated set in whose place it was compared.
    """
    named = {each.cause for each in diagnosis.causes}
    if cause in named:
        return Role.NAMED
    if cause in taken and not named.isdisjoint(taken):
        return Role.ALTERNATIVE
    return Role.STAND_IN if cause in diagnosis.findings.stand_ins else Role.OTHER


def races(diagnosis: Diagnosis) -> list[Race]:
    """Each comparison as the page of the service shows it, by log Bayes factor."""
    return [
        _race(diagnosis, title, comparison) for title, comparison in diagnosis.comparisons[:MOST_COMPARISONS]
    ]


def _race(diagnosis: Diagnosis, title: str, comparison: Comparison) -> Race:
    ranked = sorted(comparison.hypotheses, key=lambda h: -h.log_bayes_factor)
    listed = _listed(ranked, MOST_RUNNERS, comparison.taken)
    runners = [_runner(diagnosis, comparison, hypothesis) for hypothesis in listed]
    return Race(title if comparison.taken else "", runners)


def _runner(diagnosis: Diagnosis, comparison: Comparison, hypothesis: Hypothesis) -> Runner:
    cause = hypothesis.cause
    item = comparison.best_departure if cause is None else comparison.best_item(cause)
    return Runner(
        diagnosis.label_of_hypothesis(hypothesis),
        _meaning(hypothesis),
        hypothesis.log_bayes_factor,
        role_of(diagnosis, cause, comparison.taken).key,
        comparison.left_sigma(None if hypothesis.name == NOTHING else item),
    )
