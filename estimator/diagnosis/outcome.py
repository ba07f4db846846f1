"""From a search to its outcome: verdict, names and fits, as more readings, unseen readings and corrections change them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import torch

from estimator.diagnosis import policy
from estimator.diagnosis.corrections.choice import best_corrected
from estimator.diagnosis.corrections.result import Correction
from estimator.diagnosis.elsewhere import computed_on
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.hypotheses.instants import on_known_sides
from estimator.diagnosis.hypotheses.record_mistakes import RecordMistake
from estimator.diagnosis.hypotheses.search_record import Search
from estimator.diagnosis.hypotheses.step import leaves_structure
from estimator.diagnosis.limits import Limits
from estimator.diagnosis.mixture.answer import Answer
from estimator.diagnosis.mixture.naming import fitted_with_stated, named_by
from estimator.diagnosis.structure.discrepancy import discrepancy
from estimator.diagnosis.validation import (
    Improvement,
    improvement_between,
    improvement_of,
    is_refuted,
    validation_scores,
)
from estimator.diagnosis.verdict import NamedCause, Verdict, extended_fit, judged
from estimator.diagnosis.widening import Widening
from estimator.effects import EFFECTS
from estimator.effects.stages import NoiseEffect
from estimator.readings.observations import Observations


@dataclass(frozen=True)
class Outcome:
    """What a search leads to.

    Attributes:
        search: The search.
        verdict: Of the diagnosis.
        named: The causes that are named, in order.
        extended: The extended rig, fitted to the readings of the search.
        searched: The rig with all causes that were taken and that unseen readings have not refuted, fitted to the same.
        before: The rig as described, fitted to the readings that count.
        after: The extended rig, fitted to the same.
        improvement: Of the predictions of unseen readings, from `before` to `after`; None where there are none.
        widening: Growth of the intervals of `after`; None where nothing remains unexplained.
        correction: Of what no cause explains; None where nothing does.
        mixture: What stands beside what no cause explains; None where it was not asked.
    """

    search: Search
    verdict: Verdict
    named: Sequence[NamedCause]
    extended: Fit
    searched: Fit
    before: Fit
    after: Fit
    improvement: Improvement | None = None
    widening: Widening | None = None
    correction: Correction | None = None
    mixture: Answer | None = None

    @classmethod
    def of(
        cls, plain: Fit, search: Search, mistakes: Sequence[RecordMistake], is_record_wrong: bool
    ) -> Outcome:
        """What a search says by its own readings.

        Args:
            plain: The rig as described.
            search: The search.
            mistakes: Mistakes of the record, which were undone before it.
            is_record_wrong: Whether there are such mistakes, or readings that were left out.
        """
        verdict, named = judged(search)
        if verdict is Verdict.NOTHING_FOUND and is_record_wrong:
            has_twins = any(mistake.twins for mistake in mistakes)
            verdict = Verdict.INDISTINGUISHABLE if has_twins else Verdict.NAMED
        extended = extended_fit(search, named)
        return cls(search, verdict, named, extended, search.final, plain, extended)

    @property
    def is_doubtful(self) -> bool:
        """Whether something that no list holds may be there: beside the named causes, or in place of one.

        What only scatters always leaves room for it, and is no item of a mixture.
        """
        scatters = any(isinstance(EFFECTS[cause.cause.name], NoiseEffect) for cause in self.named)
        may_be_unknown = any(cause.may_be_unknown for cause in self.named) and not scatters
        return self.verdict is Verdict.UNEXPLAINED or may_be_unknown

    def partly(self, mixture: Answer) -> Outcome:
        """This outcome with the causes that a mixture states beside everything else.

        If it states none, the names of the search stay where each is rather there than not.
        """
        named = named_by(mixture)
        if not named:
            return (
                replace(self, mixture=mixture) if self._is_borne_out_by(mixture) else self._unnamed(mixture)
            )
        verdict = Verdict.NAMED if all(cause.is_alone for cause in named) else Verdict.INDISTINGUISHABLE
        if mixture.beside or leaves_structure(self.search.scatter):
            verdict = Verdict.PARTLY_EXPLAINED
        extended = fitted_with_stated(mixture)
        return replace(
            self,
            verdict=verdict,
            named=named,
            extended=extended,
            searched=extended,
            after=extended,
            mixture=mixture,
        )

    def _is_borne_out_by(self, mixture: Answer) -> bool:
        """Whether each named cause is among what the mixture finds rather there than not."""
        probable = {p.cause for entry in mixture.beside for p in entry.possibilities}
        return all(named.cause in probable for named in self.named)

    def _unnamed(self, mixture: Answer) -> Outcome:
        """This outcome without names."""
        base = self.search.base
        return replace(
            self,
            verdict=Verdict.UNEXPLAINED,
            named=(),
            extended=base,
            searched=base,
            after=base,
            mixture=mixture,
        )

    def fitted_to(self, readings: Observations) -> Outcome:
        """This outcome with fits to more readings than the search had."""
        before, after = (self._fitted_to(readings, fit) for fit in (self.before, self.extended))
        return replace(self, before=before, after=after)

    def checked_by(self, unseen: Observations) -> Outcome:
        """The outcome after readings that no fit has seen.

        A cause that they refute stands in for something else. A rig that predicts worse than the one described does not replace it.
        """
        told = on_known_sides(self.after, unseen)
        improvement = improvement_of(self.before, self.after, told)
        named = self.named
        if len(named) <= policy.MOST_CAUSES_REFITTED:
            named = [each for each in named if not is_refuted(self.after, each.cause, told)]
        is_refused = len(named) < len(self.named) or improvement.is_loss
        is_stated = bool(named) and self.mixture is not None and bool(self.mixture.stated)
        left = Verdict.PARTLY_EXPLAINED if is_stated else Verdict.UNEXPLAINED
        verdict = left if is_refused else self.verdict
        checked = replace(self, verdict=verdict, named=named, improvement=improvement)
        if not improvement.is_loss or named:
            return checked
        base, readings = self.search.base, self.before.observations
        after = base if readings is base.observations else self._fitted_to(readings, base)
        improvement = improvement_of(self.before, after, unseen)
        return replace(checked, extended=base, searched=base, after=after, improvement=improvement)

    def widened(self, unseen: Observations) -> Outcome:
        """The outcome with intervals that are widened by what is left, and without a correction.

        Args:
            unseen: Readings that no fit has seen; may be empty.
        """
        return replace(self, widening=self._widening)._scored_by(unseen)

    @property
    def _widening(self) -> Widening:
        search = self.search
        if self.extended is search.base:
            left = search.base_discrepancy
        elif self.extended is search.final:
            left = search.remainder
        else:
            weight = self.extended.weight_over(search.final)
            left = discrepancy(self.extended, [curve.weighed(weight) for curve in search.curves])
        return Widening.of(self.extended, self.after, left)

    def corrected(
        self, unseen: Observations, place: torch.device, tell: Callable[[str], None], limits: Limits
    ) -> Outcome:
        """The outcome with intervals that are widened by what is left, and with what corrects it, where that predicts better.

        Args:
            unseen: Readings that no fit has seen; may be empty.
            place: Device on which corrections are computed.
            tell: Called with a message for each correction that is taken.
            limits: No further correction is asked when they are over.
        """
        best = partial(best_corrected, tell=tell, limits=limits)
        correction = computed_on(place, best, self.extended, self.searched, self.after)
        widening = self._widening
        with_causes = replace(self, widening=widening, correction=correction)
        if not correction.is_taken:
            return with_causes._scored_by(unseen)
        final = correction.final
        with_correction = replace(
            with_causes,
            extended=correction.fit,
            after=final,
            widening=widening.carried_to(final).over_blocks(correction.fit),
        )._scored_by(unseen)
        if with_correction.improvement is None:
            return with_correction
        told = on_known_sides(final, unseen)
        before, after = validation_scores(self.after, told), with_correction.improvement.after
        correction = correction.judged_by(improvement_between(self.after, final, before, after))
        if correction.is_taken:
            return replace(with_correction, correction=correction)
        return replace(with_causes, correction=correction)._scored_by(unseen)

    def _scored_by(self, unseen: Observations) -> Outcome:
        """This outcome with the improvement on unseen readings, as sure as its widened intervals are; the same where there are none."""
        if not len(unseen):
            return self
        told = on_known_sides(self.after, unseen)
        covariance = None if self.widening is None else self.widening.covariance
        return replace(self, improvement=improvement_of(self.before, self.after, told, covariance))

    def _fitted_to(self, readings: Observations, fit: Fit) -> Fit:
        """A fit's rig, fitted to other readings."""
        return fit_rig(fit.rig, readings, fit.values, self.search.base.posterior.model.rules)
