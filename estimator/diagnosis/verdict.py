"""The verdict from a search: named, indistinguishable, unexplained, or nothing found."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import torch
from torch import Tensor

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.hypotheses.candidates import candidates
from estimator.diagnosis.hypotheses.screening import linear_evidence
from estimator.diagnosis.hypotheses.search_record import Search
from estimator.diagnosis.hypotheses.standing import explains_more_than_is_left, standing
from estimator.diagnosis.hypotheses.step import (
    Hypothesis,
    shares_of,
)
from estimator.diagnosis.linear import Projector
from estimator.diagnosis.next_readings.expected_evidence import rows_seen, separation
from estimator.diagnosis.structure.relatives import unknown_beside
from estimator.effects import EFFECTS
from estimator.rig.rig import Cause

UNKNOWN = "something not in the library"


class Verdict(StrEnum):
    """Outcome of a diagnosis; the words are stable (docs/file-formats.md)."""

    NAMED = "named"
    INDISTINGUISHABLE = "indistinguishable"
    UNEXPLAINED = "unexplained"
    NOTHING_FOUND = "nothing_found"


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
        return Verdict.UNEXPLAINED, named_causes(search, search.kept)
    named = named_causes(search, search.added)
    verdict = verdict_of(search, named)
    if verdict is Verdict.UNEXPLAINED and named:
        named = beside_discrepancy(search, named)
    return verdict, named


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


def beside_discrepancy(search: Search, named: list[NamedCause]) -> list[NamedCause]:
    """The causes that keep their evidence beside the strongest flexible curves of the first and of the last fit.

    A cause stands in for something else if it is larger than its source allows, explains less than is left, or is rather in no list. Of the
    others a few are each judged by a fit without it, many to first order about the last fit.
    """
    final = search.final
    named = [
        cause
        for cause in named
        if not only_resembles(cause) and explains_more_than_is_left(final, cause.cause, search.remainder)
    ]
    before = search.base_discrepancy.weighed(final.weight_over(search.base))
    if len(named) > policy.MOST_CAUSES_REFITTED:
        stand = standing(final, [named_cause.cause for named_cause in named], before, search.remainder)
        return [named_cause for named_cause in named if named_cause.cause in stand]
    columns = torch.cat((before.columns, search.remainder.columns), dim=1)
    still_named = []
    for cause in named:
        without = fit_rig(
            final.rig.without_cause(cause.cause),
            final.observations,
            final.values,
            final.posterior.model.rules,
        )
        with_curves = _with_columns(without, columns)
        evidence = max(linear_evidence(with_curves, candidates(without, [cause.cause])), default=-math.inf)
        if evidence > policy.LEAST_LOG_EVIDENCE_BESIDE_CURVES:
            still_named.append(cause)
    return still_named


def extended_fit(search: Search, named: Sequence[NamedCause]) -> Fit:
    """The last fit of a search where a cause was named, else the first.

    It keeps causes that were taken but not named. Without them, the named causes and the coils would bend to what they stand in for.
    """
    return search.final if named else search.base


def stand_ins(search: Search, named: Sequence[NamedCause], extended: Fit) -> list[Cause]:
    """Causes of the extended fit that are not named, for something unknown may look like them."""
    known = {cause.cause for cause in named} | set(search.base.rig.effects)
    return [cause for cause in extended.rig.effects if cause not in known]


def _with_columns(fit: Fit, columns: Tensor) -> Fit:
    """The fit as if columns with standard normal coefficients had been fitted too."""
    jacobian = torch.cat((fit.jacobian, columns), dim=1)
    prior = torch.block_diag(
        (fit.optimum.precision - fit.optimum.information)[0],
        columns.new_ones(columns.shape[1]).diag(),
    )
    projector = Projector.of(jacobian, prior)
    return fit.to_first_order(projector, projector.rest(fit.residual))


def _shares(credible: tuple[Hypothesis, ...]) -> dict[Cause, float]:
    pairs = zip(credible, shares_of(credible), strict=True)
    return {hypothesis.cause: share for hypothesis, share in pairs if hypothesis.cause is not None}
