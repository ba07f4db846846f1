"""The search for causes: take the best cause while its evidence suffices, then test each again beside the others.

Where one effect at several places explains more than any cause at one place, it is taken at all of them together
(`several_places`). Where no single cause suffices, two are tested together, for one may hide the other (`pairs`). Where causes of many
kinds pile up, another structure of the source may do for all of them (`source_structure`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain

import numpy as np
from torch import Tensor

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.hypotheses.candidates import Candidate, candidates, causes_of
from estimator.diagnosis.hypotheses.columns import Columns, without_spells
from estimator.diagnosis.hypotheses.far_off import with_far_off
from estimator.diagnosis.hypotheses.many_at_once import many_at_once
from estimator.diagnosis.hypotheses.pairs import pairs
from estimator.diagnosis.hypotheses.search_record import Addition, Search
from estimator.diagnosis.hypotheses.several_places import (
    at_several_places,
    comparison_steps,
    without_idle,
)
from estimator.diagnosis.hypotheses.source_structure import OtherStructures, is_pile, other_structures
from estimator.diagnosis.hypotheses.step import (
    Hypothesis,
    Step,
    credible_set,
    is_noise,
    least_log_evidence,
    leaves_structure,
    take_step,
    with_probabilities,
)
from estimator.diagnosis.limits import Limits
from estimator.diagnosis.progress import OnProgress, Pace, unwatched
from estimator.diagnosis.structure.cross_validation import held_out
from estimator.diagnosis.structure.discrepancy import discrepancy
from estimator.diagnosis.structure.families.collection import Family
from estimator.effects.attach import with_effect
from estimator.readings.split import pose_blocks
from estimator.reporting.numbers import odds
from estimator.rig.rig import Cause
from estimator.side_by_side import meanwhile


def search(
    columns: Columns, tell: Callable[[str], None], limits: Limits, on_progress: OnProgress = unwatched
) -> Search:
    """Add causes to a fit while their evidence suffices, then test for each whether another does better beside the rest.

    Args:
        columns: Of causes and curves at the fit of the rig as described.
        tell: Called with a message at each step.
        limits: When the search ends before the evidence does.
        on_progress: Called before and after each fit of a hypothesis.
    """
    base = columns.fit
    state = _SearchState(columns, tell, limits, on_progress)
    fit = state.forward(base)
    if len(state.added(fit)) == 1 and not limits.is_over:
        fit = state.with_two(fit)
    is_revisited = 1 < len(state.added(fit)) <= policy.MOST_CAUSES_REFITTED and not limits.is_over
    if is_revisited:
        fit = state.forward(state.revisited(fit))
    is_alone = len(state.added(fit)) == 1
    if is_alone and leaves_structure(state.steps[-1].remainder) and not limits.is_over:
        fit = state.with_alternative(fit)
    if state.added(fit):
        fit = fit_rig(fit.rig, fit.observations, fit.values, fit.posterior.model.rules, near=fit)
    curves = state.columns.curves_at(fit)
    if state.is_piled(fit):
        if state.other_structures is not None:
            state.compare_shown(fit)
        # Without that question each may still be named.
        state.compare_again(fit, state.added(fit) if state.other_structures is None else [], curves)
    else:
        state.compare_again(fit, state.not_compared(fit) if is_revisited else state.added(fit), curves)
    dropped = tuple(cause for cause in dict.fromkeys(state.dropped) if cause not in fit.rig.effects)
    return Search(
        base,
        fit,
        tuple(state.steps),
        state.additions_in(fit),
        dropped,
        tuple(columns.pool),
        state.base_discrepancy,
        tuple(curves),
        limits.words if limits.is_over else state.ended_early,
        state.other_structures,
    )


class _SearchState:
    """State of a search: its steps, and what they share (columns of causes and curves, blocks)."""

    def __init__(
        self,
        columns: Columns,
        tell: Callable[[str], None],
        limits: Limits,
        on_progress: OnProgress = unwatched,
    ) -> None:
        self.base, self.columns = columns.fit, columns
        base = columns.fit
        self.block = pose_blocks(base.observations, np.random.default_rng(0))
        self.tell, self.limits, self.on_progress = tell, limits, on_progress
        self.base_discrepancy = discrepancy(base, columns.smooth)
        self.n_compared = 0
        self.ended_early = ""
        self.other_structures: OtherStructures | None = None
        self.steps: list[Step] = []
        self.additions: list[Addition] = []
        self.dropped: list[Cause] = []
        self.reached: dict[Cause, dict[str, Tensor]] = {}  # own parameters of each cause in its last fit
        # Causes that the report of a pile shows, and how they are compared.
        self.shown: list[tuple[list[Cause], Callable[[], list[Step]]]] = []
        self.needed: set[Cause] = set()  # a fit in a pile without them was worse: they are not tried again
        self.collapsed: set[Cause] = set()  # fits in a pile found nothing of them: they are not asked again

    def added(self, fit: Fit) -> list[Cause]:
        """Causes of a fit beyond the base."""
        return [cause for cause in fit.rig.effects if cause not in self.base.rig.effects]

    def is_piled(self, fit: Fit) -> bool:
        """Whether causes of many kinds have piled up in a fit."""
        return is_pile(self.added(fit), policy.MOST_KINDS)

    def is_settled(self, fit: Fit) -> bool:
        """Whether noise was taken last in a pile, which is asked where no other cause suffices: with more noise fewer do."""
        return self.is_piled(fit) and bool(self.steps) and is_noise(self.steps[-1].taken)

    def forward(self, fit: Fit) -> Fit:
        """Take causes until the evidence for none suffices."""
        self.steps = [step for step in self.steps if step.taken in self.added(fit)]
        while True:
            is_over = self.limits.is_over
            if (
                not is_over
                and self.other_structures is None
                and is_pile(self.added(fit), policy.MOST_KINDS - 1)
            ):
                fit = self._with_other_structure(fit)
                continue
            is_over |= self.is_settled(fit)
            if not is_over and (straight := self._with_far_off(fit)) is not None:
                fit = straight
                continue
            if not is_over and (wider := self._with_several_places(fit)) is not None:
                fit = self._without_idle(wider)
                continue
            if not is_over and (wider := self._with_many(fit)) is not None:
                fit = self._without_idle(wider)
                continue
            step = self.step(fit)
            is_pair_asked = step.taken is None and not is_over and not self.is_piled(fit)
            if is_pair_asked and (both := self._with_pair(fit, step)) is not None:
                fit = both
                continue
            if step.taken is not None and len(self.added(fit)) >= self.limits.most_causes:
                self.ended_early = f"the number of causes is limited to {self.limits.most_causes}"
                self.tell(f"{step.taken.label} has enough evidence too, but {self.ended_early}")
                step = replace(step, taken=None)
            self.steps.append(step)
            if step.taken is None:
                return fit
            self.tell(
                f"taking {step.taken.label} ({odds(step.taken_fit.log_evidence - fit.log_evidence)} for it)"
            )
            self.additions.append(Addition((step.taken,), step.taken_fit))
            fit = self._without_idle(step.taken_fit)
            if step.taken not in fit.rig.effects:
                self.steps.append(replace(step, taken=None))
                return fit

    def additions_in(self, fit: Fit) -> tuple[Addition, ...]:
        """The additions, without causes that the fit no longer has."""
        added = self.added(fit)
        additions = [replace(a, causes=tuple(c for c in a.causes if c in added)) for a in self.additions]
        return tuple(addition for addition in additions if addition.causes)

    def not_compared(self, fit: Fit) -> list[Cause]:
        """Causes of a fit that no step has compared with all hypotheses."""
        return [cause for cause in self.added(fit) if self.steps[self._at(cause)].discrepancy is None]

    def compare_again(self, fit: Fit, causes: Sequence[Cause], curves: Sequence[Family]) -> None:
        """Compare those of some causes that were taken together with every other hypothesis, now beside all others; exchange nothing."""
        taken_together = [a.causes for a in self.additions if len(a.causes) > 1]
        together = [cause for cause in dict.fromkeys(chain(*taken_together)) if cause in causes]
        if not together:
            return
        self.tell(f"comparing {len(together)} causes that were taken together again, beside all others")
        self._put(comparison_steps(fit, together, self._pool(fit, self.columns), curves))

    def compare_shown(self, fit: Fit) -> None:
        """For the report of a pile: one of each kind that was taken together, compared with all hypotheses as the fit was then."""
        for causes, compared in self.shown:
            left = set(causes).intersection(self.not_compared(fit))
            if left:
                self._put([step for step in compared() if step.taken in left])

    def _put(self, compared: Sequence[Step]) -> None:
        """Put comparisons in the place of the steps in which their causes were taken."""
        for step in compared:
            assert step.taken is not None
            self.steps[self._at(step.taken)] = step

    def _compared(self, fit: Fit, causes: Sequence[Cause], columns: Columns) -> list[Step]:
        """Some causes of a fit compared with all hypotheses, with columns that were computed at a similar fit."""
        return comparison_steps(fit, causes, self._pool(fit, columns), columns.curves_at(fit))

    def revisited(self, fit: Fit) -> Fit:
        """Test each cause again beside the others: exchange it where another does better, drop it where none is needed."""
        for cause in self.added(fit):
            if self.limits.is_over:
                return fit
            self.tell(f"testing {cause.label} again, beside the others")
            without, step = self._without(fit, cause)
            if step.taken is None:
                self._drop([cause])
                fit = without
                continue
            self.steps[self._at(cause)] = step
            if step.taken != cause:
                self.tell(f"exchanging it for {step.taken.label}")
                self.additions.append(Addition((step.taken,), step.taken_fit))
                fit = step.taken_fit
        return fit

    def with_two(self, fit: Fit) -> Fit:
        """The fit with two causes of few numbers in the place of one with many, where they are more probable together.

        A cause with many numbers explains what two causes did and is taken first, for it is the best single one. The best other that was
        fitted, and paid so much less that a second can pay beside it, is then asked with one.
        """
        step = self.steps[0]
        alone = [h for h in step.hypotheses if h.fit is not None and len(self.added(h.fit)) == 1]
        fitted = [h for h in alone if not is_noise(h.cause)]
        taken = next((h for h in fitted if h.cause == step.taken), None)
        if taken is None:
            return fit
        least = least_log_evidence(self.columns.n_causes)
        other = next((h for h in fitted if self._paid(taken) - self._paid(h) > least), None)
        if other is None:
            return fit
        assert other.cause is not None
        assert other.fit is not None
        self.tell(f"testing {other.name} with another cause in place of {taken.name}")
        second = self.step(other.fit)
        if second.taken is None or len(self.added(second.taken_fit)) > self.limits.most_causes:
            return fit
        beside = next(h for h in second.hypotheses if h.cause == second.taken)
        gain = other.log_bayes_factor + beside.log_bayes_factor - taken.log_bayes_factor
        if gain < least - policy.LEAST_LOG_ODDS:  # the prior of one more cause
            return fit
        self.tell(f"{other.name} and {beside.name} together are more probable and replace it")
        self._drop(self.added(fit))
        first = replace(step, taken=other.cause, credible=credible_set(fitted, other.cause))
        self.steps = [first, second]
        self.additions = [Addition((other.cause,), other.fit), Addition((second.taken,), second.taken_fit)]
        return self.forward(second.taken_fit)

    def _paid(self, hypothesis: Hypothesis) -> float:
        """What a cause paid for its numbers: by how much its evidence against nothing is less than what it gained at its best values."""
        assert hypothesis.fit is not None
        after, before = (f.posterior.log_likelihood(f.vector) for f in (hypothesis.fit, self.base))
        return float(after - before) - hypothesis.log_bayes_factor

    def with_alternative(self, fit: Fit) -> Fit:
        """A search from another cause of the credible set, one that leaves no structure as the only cause does; or the same fit."""
        step = self.steps[0]
        for hypothesis in step.credible:
            if hypothesis.fit is None or hypothesis.cause == step.taken:
                continue
            if not leaves_structure(discrepancy(hypothesis.fit, self.columns.curves_at(hypothesis.fit))):
                self.tell(f"{hypothesis.name} leaves less structure and replaces it")
                assert hypothesis.cause is not None
                self.steps = [replace(step, taken=hypothesis.cause)]
                self.additions = [Addition((hypothesis.cause,), hypothesis.fit)]
                return self.forward(hypothesis.fit)
        return fit

    def _with_other_structure(self, pile: Fit) -> Fit:
        """The fit with another structure of the source alone, where it does better than a pile of causes; else the pile."""
        self.tell(
            f"{len(self.added(pile))} causes pile up: asking whether another structure of the source does for them"
        )
        pace = Pace("other structures of the source", self.on_progress)
        self.other_structures = other_structures(self.base, pile, self.columns.pool, self.limits, pace)
        better = self.other_structures.better
        if better is None:
            self.tell("no other structure of the source does as well")
            self.shown = [(causes, meanwhile(compared)) for causes, compared in self.shown]
            return pile
        self.tell(f"{better.cause.label} does better: starting again from it")
        self._drop(self.added(pile))
        self.steps = [self.other_structures.step(self.base, self.columns.pool, self.base_discrepancy)]
        self.additions = [Addition((better.cause,), better.alone)]
        return better.alone

    def _with_far_off(self, fit: Fit) -> Fit | None:
        """A bent fit with what had bent it, from where all other causes are then screened; None where nothing does."""
        wider = with_far_off(fit, least_log_evidence(self.columns.n_causes))
        if wider is None or len(self.added(wider)) > self.limits.most_causes:
            return None
        new = [cause for cause in wider.rig.effects if cause not in fit.rig.effects]
        gain = wider.log_evidence - fit.log_evidence
        # `revisited` compares them, where there are several.
        steps = [_alone_in_step(cause, gain, wider) for cause in new]
        if len(new) == 1:
            steps = [self.step(fit)]
            if steps[0].taken != new[0]:
                return None
            wider = steps[0].taken_fit
            gain = wider.log_evidence - fit.log_evidence
        self.tell(f"taking {', '.join(cause.label for cause in new)} ({odds(gain)} for them)")
        self.columns = Columns.at(wider, self.limits)
        self.steps += steps
        self.additions.append(Addition(tuple(new), wider))
        return wider

    def _with_several_places(self, fit: Fit) -> Fit | None:
        """The fit with one effect at several more places; None where a cause at one place does better."""
        return self._taken_together(fit, at_several_places(fit, self._pool(fit, self.columns)))

    def _with_many(self, fit: Fit) -> Fit | None:
        """The fit with several more causes where causes of many kinds have piled up; None where there are fewer than two."""
        if not self.is_piled(fit):
            return None
        return self._taken_together(fit, many_at_once(fit, self._asked_again(fit)))

    def _taken_together(self, fit: Fit, wider: Fit | None) -> Fit | None:
        """The fit with several more causes, unless it predicts blocks held out worse or has too many."""
        if wider is None or held_out(fit, wider, self.block).is_loss:
            return None
        if len(self.added(wider)) > self.limits.most_causes:
            return None
        new = [cause for cause in wider.rig.effects if cause not in fit.rig.effects]
        log_bayes_factor = wider.log_evidence - fit.log_evidence
        self.tell(f"taking {', '.join(cause.label for cause in new)} ({odds(log_bayes_factor)} for them)")
        each = [min(wider.log_evidence_for(cause), log_bayes_factor) for cause in new]
        steps = [_alone_in_step(c, value, wider) for c, value in zip(new, each, strict=True)]
        if not self.is_piled(wider):
            # Those that may be named are compared with their rivals at the end. Should a pile arise, one of each kind is shown.
            shown = list({cause.name: cause for cause in reversed(new)}.values())
            self.shown.append((shown, partial(self._compared, wider, shown, self.columns)))
        self.steps += steps
        self.additions.append(Addition(tuple(new), wider))
        return wider

    def _with_pair(self, fit: Fit, last: Step) -> Fit | None:
        """The fit with two more causes whose evidence suffices together and beside each other; None where there is no such pair."""
        taken = (*fit.rig.effects, *self.dropped)
        # Steps stand for spells here: pairs of all spells would be many times as many.
        pool = [
            candidate
            for candidate in without_spells(self._pool(fit, self.columns))
            if candidate.cause not in taken
        ]
        n = len({c.cause for c in pool})
        if n < 2 or len(self.added(fit)) + 2 > self.limits.most_causes:
            return None
        nothing = policy.LOG_PRIOR_NOTHING + policy.LEAST_LOG_ODDS
        unexplained = policy.LOG_PRIOR_UNEXPLAINED + last.remainder.log_bayes_factor
        least = max(nothing, unexplained) - 2.0 * policy.LOG_PRIOR_CAUSE + math.log(0.5 * n * (n - 1))
        ranked = pairs(fit, pool, least)
        if not ranked:
            return None
        _, first, second = ranked[0]
        self.tell(f"testing {first.cause.label} and {second.cause.label} together")
        rig = with_effect(fit.rig, first.cause, fit.observations, first.shapes)
        rig = with_effect(rig, second.cause, fit.observations, second.shapes)
        rules = fit.posterior.model.rules
        both = fit_rig(rig, fit.observations, fit.start_with(rig), rules, near=fit)
        if both.log_evidence - fit.log_evidence <= least:
            return None
        steps = []
        for cause in (first.cause, second.cause):
            _, step = self._without(both, cause)
            if step.taken is None:
                return None
            steps.append(step)
            both = both if step.taken == cause else step.taken_fit
        self.steps += steps
        self.additions.append(Addition(tuple(step.taken for step in steps if step.taken), both))
        return both

    def step(self, fit: Fit, left_out: Cause | None = None) -> Step:
        """Compare all hypotheses at a fit, from which a cause may have been left out that it is asked to have again."""
        self.n_compared += 1
        pace = Pace(f"step {self.n_compared}", self.on_progress)
        remainder = self.base_discrepancy if fit is self.base and fit is self.columns.fit else None
        is_piled = self.is_piled(fit)
        limits = (
            replace(self.limits, minutes=0.0) if self.is_settled(fit) else self.limits
        )  # fits nothing more
        step = take_step(
            fit,
            self._asked_again(fit),
            self.columns.curves_at(fit),
            self.block,
            limits,
            pace,
            is_piled,
            remainder,
            self.reached,
            left_out,
        )
        for hypothesis in step.hypotheses:
            if hypothesis.fit is not None and hypothesis.cause is not None:
                self._reach(hypothesis.cause, hypothesis.fit)
                if is_piled and hypothesis.log_bayes_factor <= 0.0:
                    self.collapsed.add(hypothesis.cause)
        return step

    def _without(self, fit: Fit, cause: Cause) -> tuple[Fit, Step]:
        """The fit without one of its causes, and all hypotheses compared there; the cause starts where it was."""
        rig, rules = fit.rig.without_cause(cause), fit.posterior.model.rules
        without = fit_rig(rig, fit.observations, fit.values, rules, near=fit)
        self._reach(cause, fit)
        return without, self.step(without, cause)

    def _reach(self, cause: Cause, fit: Fit) -> None:
        """Remember where a fit has found a cause."""
        values = fit.values
        self.reached[cause] = {n: v for n, v in values.items() if n.startswith(f"{cause.label}.")}

    def _without_idle(self, fit: Fit) -> Fit:
        """The fit without causes that are no longer needed."""
        fit, dropped = without_idle(fit, self.base, self.needed if self.is_piled(fit) else None)
        self._drop(dropped)
        return fit

    def _drop(self, causes: list[Cause]) -> None:
        self.dropped += causes
        self.steps = [step for step in self.steps if step.taken not in causes]

    def _at(self, cause: Cause) -> int:
        return next(i for i, step in enumerate(self.steps) if step.taken == cause)

    def _pool(self, fit: Fit, columns: Columns) -> list[Candidate]:
        """Columns of causes at a fit, those included that concern the session only beside a cause that it has."""
        pool = columns.pool_at(fit)
        if fit is columns.fit:
            return pool
        known = {*self.base.rig.effects, *columns.asked}
        others = [cause for cause in causes_of(fit.rig, fit, self.limits) if cause not in known]
        return [*pool, *candidates(fit, others)]

    def _asked_again(self, fit: Fit) -> list[Candidate]:
        """The pool without causes of which a fit in a pile has found nothing, and in a pile without spells, which double it."""
        pool = [
            candidate for candidate in self._pool(fit, self.columns) if candidate.cause not in self.collapsed
        ]
        return without_spells(pool) if self.is_piled(fit) else pool


def _alone_in_step(cause: Cause, log_bayes_factor: float, after: Fit) -> Step:
    """A step that compared one of several causes with nothing else than nothing."""
    gain = Hypothesis(cause, cause.label, log_bayes_factor, fit=after)
    hypotheses = with_probabilities([Hypothesis(None, "nothing", 0.0), gain], 1)
    return Step(tuple(hypotheses), cause, credible_set([gain], cause), None)
