"""The verdict from a search: named, indistinguishable, unexplained, or nothing found. A mixture may explain a part (`mixture.naming`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.hypotheses.search_record import Search
from estimator.diagnosis.hypotheses.step import (
    Hypothesis,
    shares_of,
)
from estimator.diagnosis.next_readings.expected_evidence import rows_seen, separation
from estimator.diagnosis.structure.relatives import unknown_beside
from estimator.effects import EFFECTS
from estimator.rig.rig import Cause

UNKNOWN = "something not in the library"


class Verdict(StrEnum):
    """Outcome of a diagnosis; the words are stable (docs/file-formats.md)."""

    NAMED = "named"
    INDISTINGUISHABLE = "indistinguishable"
    PARTLY_EXPLAINED = "partly_explained"
    UNEXPLAINED = "unexplained"
    NOTHING_FOUND = "nothing_found"

    @property
    def leaves_something(self) -> bool:
        """Whether something is wrong that no known cause explains."""
        return self in (Verdict.PARTLY_EXPLAINED, Verdict.UNEXPLAINED)


@dataclass(frozen=True)
class Alternative:
    """Another cause that a named one could be.

    Attributes:
        probability: Posterior probability, beside the other causes of the credible set and what no list holds.
        expected_log_evidence: Expected log Bayes factor of the named cause against this one from these readings, were the named one true;
            None where this one was not fitted in full.
    """

    cause: Cause
    probability: float
    expected_log_evidence: float | None


@dataclass(frozen=True)
class NamedCause:
    """One cause of the verdict.

    Attributes:
        cause: Name and place.
        probability: Posterior probability, beside its alternatives and what no list holds.
        alternatives: The other causes of its 95 % credible set.
        log_bayes_factor: Against nothing, when it was taken.
        p_not_in_library: Probability that it is something else which no list holds.
        most_beside: Up to which its name is stated alone.
    """

    cause: Cause
    probability: float
    alternatives: tuple[Alternative, ...]
    log_bayes_factor: float
    p_not_in_library: float = 0.0
    most_beside: float = policy.MOST_BESIDE_A_NAME

    @property
    def may_be_unknown(self) -> bool:
        """Whether something that no list holds belongs to its credible set, so that the name is not alone."""
        return self.p_not_in_library > self.most_beside

    @property
    def is_alone(self) -> bool:
        """Whether nothing else is in its credible set."""
        return not (self.alternatives or self.may_be_unknown)


def judged(search: Search) -> tuple[Verdict, list[NamedCause]]:
    """The outcome of a search, and the causes that are named with it.

    Where causes of many kinds pile up, something is unexplained whatever they are called.
    """
    if search.source_seems_wrong:
        return Verdict.UNEXPLAINED, []
    named = named_causes(search, search.added)
    verdict = verdict_of(search, named)
    return verdict, [] if verdict is Verdict.UNEXPLAINED else named


def verdict_of(search: Search, named: list[NamedCause]) -> Verdict:
    """The outcome. `unexplained` where structure remains, or where a flexible curve does better than several causes together."""
    prior = policy.LOG_PRIOR_UNEXPLAINED - policy.LOG_PRIOR_NOTHING
    if search.leaves_structure:
        return Verdict.UNEXPLAINED
    curve_log_odds = search.base_discrepancy.log_bayes_factor + prior
    if len(named) > 1 and curve_log_odds > max(policy.LEAST_LOG_ODDS, search.log_odds):
        return Verdict.UNEXPLAINED
    if not named:
        return Verdict.NOTHING_FOUND
    if _idealise_the_same(named) or any(only_resembles(cause) for cause in named):
        return Verdict.UNEXPLAINED
    return Verdict.NAMED if all(cause.is_alone for cause in named) else Verdict.INDISTINGUISHABLE


def only_resembles(named: NamedCause) -> bool:
    """Whether a cause is rather something that no list holds."""
    return named.p_not_in_library > policy.MOST_NOT_IN_LIBRARY


def _idealise_the_same(named: list[NamedCause]) -> bool:
    """Whether two causes idealise the same object, such as a plate and a sphere of iron; then it is neither."""
    effects = [EFFECTS[name] for name in {cause.cause.name for cause in named}]
    objects = [effect.idealises for effect in effects if effect.idealises is not None]
    return len(objects) > len(set(objects))


def named_causes(search: Search, causes: Sequence[Cause]) -> list[NamedCause]:
    """Some causes of the final fit in the order in which they were taken, each with its credible set."""
    steps = [step for step in search.steps if step.taken in causes]
    taken = [step.taken for step in steps if step.taken is not None]
    named = []
    for step, unknown in zip(steps, unknown_beside(search.final, taken, search.curves), strict=True):
        assert step.taken is not None
        shares = {
            cause: (1.0 - unknown.probability) * share for cause, share in _shares(step.credible).items()
        }
        leader = next(hypothesis for hypothesis in step.credible if hypothesis.cause == step.taken)
        others = [hypothesis for hypothesis in step.credible if hypothesis.cause != step.taken]
        alternatives = tuple(
            Alternative(hypothesis.cause, shares[hypothesis.cause], _expected(leader, hypothesis))
            for hypothesis in others
            if hypothesis.cause is not None
        )
        named.append(
            NamedCause(
                step.taken,
                shares[step.taken],
                alternatives,
                leader.log_bayes_factor,
                unknown.probability,
                unknown.most_beside,
            )
        )
    return named


def _expected(truth: Hypothesis, hypothesis: Hypothesis) -> float | None:
    """Expected log evidence of the readings so far for one hypothesis, were it true, against another."""
    if truth.fit is None or hypothesis.fit is None:
        return None
    fits = {truth.name: truth.fit, hypothesis.name: hypothesis.fit}
    return float(separation(fits, rows_seen(fits))[0])


def extended_fit(search: Search, named: Sequence[NamedCause]) -> Fit:
    """The last fit of a search where a cause was named, else the first.

    It keeps causes that were taken but not named. Without them, the named causes and the coils would bend to what they stand in for.
    """
    return search.final if named else search.base


def stand_ins(search: Search, named: Sequence[NamedCause], extended: Fit) -> list[Cause]:
    """Causes of the extended fit that are not named, for something unknown may look like them."""
    known = {cause.cause for cause in named} | set(search.base.rig.effects)
    return [cause for cause in extended.rig.effects if cause not in known]


def _shares(credible: tuple[Hypothesis, ...]) -> dict[Cause, float]:
    pairs = zip(credible, shares_of(credible), strict=True)
    return {hypothesis.cause: share for hypothesis, share in pairs if hypothesis.cause is not None}
