"""Asks what is wrong beside mistakes of the record, and doubts these where they only made the readings fit a wrong model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

from estimator.diagnosis import effort
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.hypotheses.far_elsewhere import far_elsewhere, refit_outside
from estimator.diagnosis.hypotheses.record_mistakes import (
    leaves_much_of_the_field,
    without_record_mistakes,
)
from estimator.diagnosis.limits import Limits
from estimator.diagnosis.mixture.answer import Answer
from estimator.diagnosis.mixture.full_fits import leading_fit
from estimator.diagnosis.mixture.scatter import BesideScatter, answer_beside_scatter
from estimator.diagnosis.next_readings.resolution import Visible, indistinguishable, smallest_visible
from estimator.diagnosis.progress import OnProgress
from estimator.diagnosis.verdict import NamedCause
from estimator.errors import InvalidInput
from estimator.rig.rig import Cause


class Asking(NamedTuple):
    """What the readings say beside mistakes of the record, and what they can show and tell apart of any cause."""

    said: BesideScatter
    mistakes: Sequence[NamedCause]
    visible: Sequence[Visible]
    twins: Sequence[tuple[Cause, ...]]


def asked_beside_mistakes(
    plain: Fit,
    refusal: InvalidInput | None,
    limits: Limits,
    seed: int,
    tell: Callable[[str], None],
    on_progress: OnProgress,
) -> Asking:
    """What the readings say beside mistakes of the record; without such mistakes where they are doubtful.

    A geometry that is refused is that of the record: it counts unless a mistake of the record, or another place of a body, puts it right.
    Where such a place explains the readings better than mistakes of the record do, there are none, and the place is a cause.
    """

    def asked(base: Fit, mistakes: Sequence[NamedCause]) -> Asking:
        said = answer_beside_scatter(base, limits, seed, tell, on_progress)
        first = said.answer.first
        at = (first.expansion.fit, first.pool)  # of one noise: a cause of scatter weighs readings anew
        return Asking(said, mistakes, smallest_visible(*at), indistinguishable(*at))

    tell("looking for mistakes of the record")
    base, mistakes = without_record_mistakes(plain)
    if mistakes or refusal is not None:
        elsewhere = far_elsewhere(plain, refusal)
        if elsewhere and elsewhere[0].log_evidence > base.log_evidence:
            named = _named(plain, elsewhere)
            tell(f"asking what is wrong beside {named.cause.label}")
            there = asked(elsewhere[0], [])
            if not _are_doubtful([named], there.said.answer):
                return there._replace(said=replace(there.said, given=(named, *there.said.given)))
    if refusal is not None:
        base = refit_outside(base, refusal)
    tell("asking what is wrong")
    with_record_put_right = asked(base, mistakes)
    if mistakes and _are_doubtful(mistakes, with_record_put_right.said.answer):
        if refusal is not None:
            raise refusal
        tell("the mistakes of the record are doubtful: asking again with the record as it is")
        return asked(plain, [])
    return with_record_put_right


def _named(plain: Fit, elsewhere: Sequence[Fit]) -> NamedCause:
    """The best of other places of bodies, with those that explain the readings nearly as well."""
    evidence = {fit.rig.effects[-1]: fit.log_evidence for fit in elsewhere}
    return NamedCause.among(evidence, elsewhere[0].log_evidence - plain.log_evidence)


def _are_doubtful(mistakes: Sequence[NamedCause], answer: Answer) -> bool:
    """Whether undoing the mistakes of the record may only have made the readings fit a wrong model.

    It may if something remains unexplained, and either that is more than a mistake explained, or the record as it was put right still left
    more of the field than causes do. It also may if the causes that were found explain the unchanged record better.
    """
    left, base, final = answer.left, answer.plain, leading_fit(answer)
    least = min(mistake.log_bayes_factor for mistake in mistakes)
    is_little = least < left.log_bayes_factor or leaves_much_of_the_field(base)
    if answer.leaves_something and is_little:
        return True
    rig = final.rig
    for mistake in mistakes:
        rig = rig.without_cause(mistake.cause)
    if not rig.effects:
        return False
    rules = final.posterior.model.rules
    as_recorded = fit_rig(rig, base.observations, rig.nominal_values(), rules, effort.MORE_STARTS)
    return as_recorded.log_evidence > final.log_evidence
