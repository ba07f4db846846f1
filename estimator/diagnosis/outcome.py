"""From what the readings say to a verdict, names and fits, as more readings, unseen readings and corrections change them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from estimator.diagnosis.budget import Budget, budget
from estimator.diagnosis.corrections.result import Correction
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.hypotheses.instants import on_known_sides
from estimator.diagnosis.limits import Limits
from estimator.diagnosis.mixture.answer import Answer
from estimator.diagnosis.mixture.correcting import corrected
from estimator.diagnosis.mixture.full_fits import fit_with, leading_fit
from estimator.diagnosis.mixture.naming import fitted_with_stated, named_by
from estimator.diagnosis.mixture.numbers import Numbers
from estimator.diagnosis.mixture.scatter import BesideScatter
from estimator.diagnosis.predicted_field import missed_in_any_session_T
from estimator.diagnosis.structure.pull import Pull, pull_of
from estimator.diagnosis.structure.scatter import Scatter, scatter_of
from estimator.diagnosis.validation import (
    Improvement,
    improvement_between,
    improvement_of,
    validation_scores,
)
from estimator.diagnosis.verdict import NamedCause, Verdict
from estimator.diagnosis.widening import Widening
from estimator.readings.observations import Observations
from estimator.rig.rig import Cause

FEWEST_MOVED = 3.0  # components of unseen readings that a cause should move, for these to tell that it is next to nothing


@dataclass(frozen=True)
class Outcome:
    """What a diagnosis leads to.

    Attributes:
        answer: What the readings say.
        scatter: Whether they scatter otherwise than the leading causes say.
        pull: Whether the fit with these pulls a number of the rig far from its prior.
        verdict: Of the diagnosis.
        named: The causes that are named.
        extended: The rig with them, fitted to the readings that were asked.
        before: The rig as described, fitted to the readings that count.
        after: The extended rig, fitted to the same.
        improvement: Of the predictions of unseen readings, from `before` to `after`; None where there are none.
        widening: Growth of the intervals of `after`; None where nothing remains unexplained.
        correction: Of what no stated cause explains; None where nothing is left.
        budget: Shares of the misfit of unseen readings; None where there are none, or where the rig as described misses nothing.
    """

    answer: Answer
    scatter: Scatter
    pull: Pull
    verdict: Verdict
    named: Sequence[NamedCause]
    extended: Fit
    before: Fit
    after: Fit
    improvement: Improvement | None = None
    widening: Widening | None = None
    correction: Correction | None = None
    budget: Budget | None = None

    @classmethod
    def of(
        cls, plain: Fit, said: BesideScatter, mistakes: Sequence[NamedCause], is_record_wrong: bool
    ) -> Outcome:
        """What the readings say by themselves.

        Args:
            plain: The rig as described.
            said: The answer of the readings.
            mistakes: Mistakes of the record, which were undone before it.
            is_record_wrong: Whether there are such mistakes, or readings that were left out.
        """
        answer = said.answer
        named = [*named_by(answer), *said.stated]
        scatter, pull = scatter_of(leading_fit(answer)), pull_of(leading_fit(answer))
        is_sure = len(said.stated) == len(said.given)
        leaves = answer.leaves_something or scatter.is_probable or pull.is_probable or not is_sure
        if leaves:
            verdict = _leaving_something(named)
        elif named or is_record_wrong:
            is_clear = all(cause.is_alone for cause in (named or mistakes))
            verdict = Verdict.NAMED if is_clear else Verdict.INDISTINGUISHABLE
        else:
            verdict = Verdict.NOTHING_FOUND
        extended = fitted_with_stated(answer) if answer.stated else answer.plain
        return cls(answer, scatter, pull, verdict, named, extended, plain, extended)

    def fitted_to(self, readings: Observations) -> Outcome:
        """This outcome with fits to more readings than were asked."""
        before, after = (_fitted_to(readings, fit) for fit in (self.before, self.extended))
        return replace(self, before=before, after=after)

    def checked_by(self, unseen: Observations, seed: int) -> Outcome:
        """The outcome with the error budget, and without causes that account for next to nothing of it or that the corrections replace.

        Where other things move the readings a hundred times as much, what is as small as that may be any of many things. But of a cause
        that moves few readings they may hold none. A rig that predicts these readings worse than the one described does not replace it.

        Args:
            unseen: Readings that no fit has seen; may be empty.
            seed: Of the choice of readings for the intervals of the shares.
        """
        if self.named and self._loses_on(unseen):
            return self._refuted_by(unseen).checked_by(unseen, seed)
        scored = self if self.improvement is not None else self._scored_by(unseen)
        shares = budget(self.answer.plain, self.extended, on_known_sides(self.extended, unseen), seed)
        is_corrected = self.correction is not None and self.correction.is_taken
        named = [
            each
            for each in self.named
            if not (
                shares is not None and shares.is_negligible(each.cause) and self._moves(each.cause, unseen)
            )
            and not (is_corrected and self.after.has_nothing_of(each.cause))
        ]
        result = replace(scored._naming(named), budget=shares)
        is_open = result.verdict.leaves_something and result.widening is None
        return result.widened(unseen) if is_open else result

    def _loses_on(self, unseen: Observations) -> bool:
        """Whether it predicts unseen readings worse than the rig as described, both without widened intervals."""
        improvement = replace(self, widening=None)._scored_by(unseen).improvement
        return improvement is not None and improvement.is_loss

    def _moves(self, cause: Cause, unseen: Observations) -> bool:
        """Whether a cause should move some components of unseen readings, if as large a share of them as of those that were asked."""
        is_asked = any(item.cause == cause for item in self.answer.asked.dictionary.items)
        n_components = int(unseen.is_measured.sum())
        return not is_asked or self.answer.share_moved(cause) * n_components > FEWEST_MOVED

    def _by_names_alone(self, named: Sequence[NamedCause]) -> Outcome:
        """This outcome with nothing but some of its named causes, to be scored and widened anew."""
        base = self.answer.plain
        extended = fit_with(self.answer, [each.cause for each in named if each.cause not in base.rig.acting])
        readings = self.before.observations
        after = extended if readings is base.observations else _fitted_to(readings, extended)
        verdict = _leaving_something(named)
        return Outcome(self.answer, self.scatter, self.pull, verdict, named, extended, self.before, after)

    def _refuted_by(self, unseen: Observations) -> Outcome:
        """This outcome, which predicts unseen readings worse, with an alternative in the place of a name, else without the worst name.

        Readings that were taken when a spell was over tell it from a step, which those that were asked may not.
        """
        asked_alone = {candidate.cause for candidate in self.answer.first.pool}
        names = [
            (i, replace(named, cause=other.cause))
            for i, named in enumerate(self.named)
            for other in named.alternatives
            if other.cause in asked_alone  # a second piece of iron is none without a first
        ]
        own = self._by_names_alone(self.named)._scored_by(unseen)
        others = [self._with_name(i, named)._scored_by(unseen) for i, named in names]
        best = max(range(len(names)), key=lambda n: others[n]._gain, default=None)
        if best is not None and others[best]._gain >= 0.0:
            i = names[best][0]
            gains = {self.named[i].cause: own._gain}
            gains |= {n.cause: o._gain for (j, n), o in zip(names, others, strict=True) if j == i}
            return self._with_name(i, self.named[i].weighed_by(gains))
        fewer = [self._with_name(i)._scored_by(unseen) for i in range(len(self.named))]
        less = max(fewer, key=lambda each: each._gain, default=self._by_names_alone(()))
        return less._refuted_by(unseen) if less._gain < 0.0 and less.named else less

    def _with_name(self, i: int, *instead: NamedCause) -> Outcome:
        """This outcome with its names alone, and another or none in the place of one of them."""
        return self._by_names_alone([*self.named[:i], *instead, *self.named[i + 1 :]])

    @property
    def _gain(self) -> float:
        """Rise of the log density of the unseen readings over the rig as described; 0 where none tells.

        Outcomes whose instants differ are judged by different readings, so that log densities themselves are not comparable.
        """
        return 0.0 if self.improvement is None else self.improvement.elpd_difference

    def _naming(self, named: Sequence[NamedCause]) -> Outcome:
        """This outcome with some of its named causes; what the others stood for is unexplained."""
        is_less = len(named) < len(self.named)
        return replace(self, named=named, verdict=_leaving_something(named) if is_less else self.verdict)

    def widened(self, unseen: Observations) -> Outcome:
        """The outcome with intervals that are widened by what is left, and without a correction.

        Args:
            unseen: Readings that no fit has seen; may be empty.
        """
        return replace(self, widening=self._widening(self.extended, self.after))._scored_by(unseen)

    def corrected(self, unseen: Observations, limits: Limits, tell: Callable[[str], None]) -> Outcome:
        """The outcome with intervals that are widened by what is left, and with what corrects it, where that predicts better.

        Args:
            unseen: Readings that no fit has seen; may be empty.
            limits: Nothing is corrected when they are over.
            tell: Called with what is corrected.
        """
        correction = corrected(self.answer, self.extended, self.after, limits)
        uncorrected = replace(self, correction=correction)
        if not correction.is_taken:
            return uncorrected.widened(unseen)
        tell(f"correcting by {', '.join(part.cause.label for part in correction.parts) or 'further causes'}")
        final = correction.final
        with_correction = replace(
            uncorrected,
            extended=correction.fit,
            after=final,
            widening=self._widening(correction.fit, final),
        )._scored_by(unseen)
        if with_correction.improvement is None:
            return with_correction
        told = on_known_sides(final, unseen)
        before, after = validation_scores(self.after, told), with_correction.improvement.after
        missed_T = missed_in_any_session_T(self.after, told), missed_in_any_session_T(final, told)
        correction = correction.judged_by(improvement_between(self.after, final, before, after), missed_T)
        if correction.is_taken:
            return replace(with_correction, correction=correction)
        return replace(self, correction=correction).widened(unseen)

    @cached_property
    def _numbers(self) -> Numbers:
        return Numbers.of(self.answer)

    def _widening(self, searched: Fit, final: Fit) -> Widening:
        return Widening.of(searched, final, self._numbers.names, self._numbers.about(final))

    def _scored_by(self, unseen: Observations) -> Outcome:
        """This outcome with the improvement on unseen readings, as sure as its widened intervals are; the same where there are none."""
        told = on_known_sides(self.after, unseen) if len(unseen) else unseen
        if not len(told):
            return replace(self, improvement=None)
        covariance = None if self.widening is None else self.widening.covariance
        return replace(self, improvement=improvement_of(self.before, self.after, told, covariance))


def _leaving_something(named: Sequence[NamedCause]) -> Verdict:
    return Verdict.PARTLY_EXPLAINED if named else Verdict.UNEXPLAINED


def _fitted_to(readings: Observations, fit: Fit) -> Fit:
    """A fit's rig, fitted to other readings."""
    return fit_rig(fit.rig, readings, fit.values, fit.posterior.model.rules)
