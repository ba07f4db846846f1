"""Naming causes: take the best where it earns its place, and begin again.

A kind of cause that explains more at several places than any cause does at one is taken at all of those at once. Causes taken earlier
are asked again in the presence of the others. Where no single cause earns its place, two are asked together, for one may hide the other.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.hypotheses.candidates import Candidate, candidates, causes_of
from estimator.diagnosis.hypotheses.kinds import of_one_kind, steps_of
from estimator.diagnosis.hypotheses.pairs import pairs
from estimator.diagnosis.hypotheses.step import (
    Step,
    leaves_structure,
    take_step,
)
from estimator.diagnosis.structure.cross_validation import held_out
from estimator.diagnosis.structure.discrepancy import Discrepancy, Family, discrepancy, families
from estimator.effects.attach import with_effect
from estimator.readings.split import pose_blocks
from estimator.rig.rig import Cause


@dataclass(frozen=True)
class Stage:
    """Causes that were taken in one go, and the fit with them."""

    causes: tuple[Cause, ...]
    fit: Fit


@dataclass(frozen=True)
class Search:
    """How the causes were found.

    Attributes:
        base, final: Fits before and after.
        steps: How each cause compares with every other hypothesis, in order; the last one took nothing.
        stages: Of those that were kept, in order.
        dropped: Causes that were taken and later no longer earned their place.
        pool: Columns of every cause at the base.
        whole: The discrepancy at the base.
    """

    base: Fit
    final: Fit
    steps: tuple[Step, ...]
    stages: tuple[Stage, ...]
    dropped: tuple[Cause, ...]
    pool: tuple[Candidate, ...]
    whole: Discrepancy

    def step_of(self, cause: Cause) -> Step:
        """How a cause that was taken compares with every other hypothesis."""
        return next(step for step in self.steps if step.taken == cause)

    @property
    def log_odds(self) -> float:
        """Of all that was taken, against nothing."""
        n = len(self.final.rig.effects) - len(self.base.rig.effects)
        each = policy.LOG_PRIOR_CAUSE - math.log(len({c.cause for c in self.pool})) - policy.LOG_PRIOR_NOTHING
        return self.final.log_evidence - self.base.log_evidence + n * each


def search(base: Fit, tell: Callable[[str], None], most_causes: int = policy.MOST_CAUSES) -> Search:
    """Add causes to a fit while they earn it, then ask of each again whether another would do better beside the others.

    Args:
        base: The rig as it is described, fitted.
        tell: Told what is going on, step by step.
        most_causes: Where it ends though another would earn its place.
    """
    pool = candidates(base, causes_of(base.rig, base))
    trail = _Trail(base, pool, families(base), tell, most_causes)
    whole = discrepancy(base, trail.smooth)
    fit = trail.forward(base)
    if 1 < len(trail.own(fit)) <= policy.MOST_CAUSES_REFITTED:
        fit = trail.forward(trail.revisited(fit))
    else:
        trail.compare_again(fit)
    if len(trail.own(fit)) == 1 and leaves_structure(trail.steps[-1].left):
        fit = trail.with_alternative(fit)
    if trail.own(fit):
        fit = fit_rig(fit.rig, fit.observations, fit.values, fit.posterior.model.rules)
    dropped = tuple(cause for cause in dict.fromkeys(trail.dropped) if cause not in fit.rig.effects)
    return Search(base, fit, tuple(trail.steps), trail.kept(fit), dropped, tuple(pool), whole)


class _Trail:
    """The steps of a search, with what all of them share: columns of the causes, smooth families."""

    def __init__(
        self,
        base: Fit,
        pool: list[Candidate],
        smooth: list[Family],
        tell: Callable[[str], None],
        most_causes: int,
    ) -> None:
        self.base, self.pool, self.smooth = base, pool, smooth
        self.block = pose_blocks(base.observations, np.random.default_rng(0))
        self.tell, self.most_causes = tell, most_causes
        self.steps: list[Step] = []
        self.stages: list[Stage] = []
        self.dropped: list[Cause] = []

    def own(self, fit: Fit) -> list[Cause]:
        """Causes of a fit beyond the base."""
        return [cause for cause in fit.rig.effects if cause not in self.base.rig.effects]

    def forward(self, fit: Fit) -> Fit:
        """Take causes until none earns its place."""
        self.steps = [step for step in self.steps if step.taken in self.own(fit)]
        while True:
            if (several := self._with_kind(fit)) is not None:
                fit = self._without_idle(several)
                continue
            step = self.step(fit)
            if step.taken is None and (both := self._with_pair(fit, step)) is not None:
                fit = both
                continue
            if step.taken is not None and len(self.own(fit)) >= self.most_causes:
                self.tell(
                    f"{step.taken.label} would earn a place too, but {self.most_causes} causes are the most"
                )
                step = replace(step, taken=None)
            self.steps.append(step)
            if step.taken is None:
                return fit
            self.tell(
                f"{step.taken.label} earns its place ({step.winner.log_evidence - fit.log_evidence:+.1f} in log evidence)"
            )
            self.stages.append(Stage((step.taken,), step.winner))
            fit = self._without_idle(step.winner)
            if step.taken not in fit.rig.effects:
                self.steps.append(replace(step, taken=None))
                return fit

    def kept(self, fit: Fit) -> tuple[Stage, ...]:
        """The stages, without causes that the fit has not got any more."""
        own = self.own(fit)
        kept = [replace(stage, causes=tuple(c for c in stage.causes if c in own)) for stage in self.stages]
        return tuple(stage for stage in kept if stage.causes)

    def compare_again(self, fit: Fit) -> None:
        """What was taken at several places at once with every other hypothesis, now that all others are there; nothing is exchanged."""
        together = [c for stage in self.kept(fit) if len(stage.causes) > 1 for c in stage.causes]
        if not together:
            return
        self.tell(f"{len(together)} that were taken together are compared again, beside all others")
        steps = steps_of(fit, together, self._pool(fit), self._smooth(fit))
        for cause, step in zip(together, steps, strict=True):
            self.steps[self._at(cause)] = step

    def revisited(self, fit: Fit) -> Fit:
        """Each cause again, in the presence of the others: exchanged where another does better, dropped where none is needed."""
        for cause in self.own(fit):
            without = fit_rig(
                fit.rig.without_cause(cause), fit.observations, fit.values, fit.posterior.model.rules
            )
            self.tell(f"{cause.label} again, beside the others")
            step = self.step(without)
            if step.taken is None:
                self._drop([cause])
                fit = without
                continue
            self.steps[self._at(cause)] = step
            if step.taken != cause:
                self.tell(f"{step.taken.label} does better in its place")
                self.stages.append(Stage((step.taken,), step.winner))
                fit = step.winner
        return fit

    def with_alternative(self, fit: Fit) -> Fit:
        """Where the one cause that was taken leaves structure, another of its credible set that leaves none."""
        step = self.steps[0]
        for rival in step.credible:
            if rival.fit is None or rival.cause == step.taken:
                continue
            if not leaves_structure(discrepancy(rival.fit, self._smooth(rival.fit))):
                self.tell(f"{rival.name} in its place leaves less")
                assert rival.cause is not None
                self.steps = [replace(step, taken=rival.cause)]
                self.stages = [Stage((rival.cause,), rival.fit)]
                return self.forward(rival.fit)
        return fit

    def _with_kind(self, fit: Fit) -> Fit | None:
        """One kind of cause at several places more; None where a cause at one place does better."""
        wider = of_one_kind(fit, self._pool(fit))
        if wider is None or held_out(fit, wider, self.block).is_loss:
            return None
        if len(self.own(wider)) > self.most_causes:
            return None
        more = [cause for cause in wider.rig.effects if cause not in fit.rig.effects]
        gain = wider.log_evidence - fit.log_evidence
        self.tell(
            f"{', '.join(cause.label for cause in more)} earn their places ({gain:+.1f} in log evidence)"
        )
        self.steps += steps_of(wider, more, self._pool(wider), self._smooth(wider))
        self.stages.append(Stage(tuple(more), wider))
        return wider

    def _with_pair(self, fit: Fit, stop: Step) -> Fit | None:
        """Two causes more that earn their place together, and beside each other; None where no pair does."""
        taken = (*fit.rig.effects, *self.dropped)
        pool = [c for c in self._pool(fit) if c.cause not in taken]
        n = len({c.cause for c in pool})
        ranked = pairs(fit, pool)
        if not ranked or len(self.own(fit)) + 2 > self.most_causes:
            return None
        nothing = policy.LOG_PRIOR_NOTHING + policy.LEAST_LOG_ODDS
        unexplained = policy.LOG_PRIOR_UNEXPLAINED + stop.left.log_bayes_factor
        least = max(nothing, unexplained) - 2.0 * policy.LOG_PRIOR_CAUSE + math.log(0.5 * n * (n - 1))
        value, one, other = ranked[0]
        if value <= least:
            return None
        self.tell(f"{one.cause.label} and {other.cause.label} are asked together")
        rig = with_effect(fit.rig, one.cause, fit.observations, one.shapes)
        rig = with_effect(rig, other.cause, fit.observations, other.shapes)
        both = fit_rig(rig, fit.observations, fit.start_with(rig), fit.posterior.model.rules)
        if both.log_evidence - fit.log_evidence <= least:
            return None
        steps = []
        for cause in (one.cause, other.cause):
            without = fit_rig(
                both.rig.without_cause(cause), fit.observations, both.values, fit.posterior.model.rules
            )
            step = self.step(without)
            if step.taken is None:
                return None
            steps.append(step)
            both = both if step.taken == cause else step.winner
        self.steps += steps
        self.stages.append(Stage(tuple(step.taken for step in steps if step.taken), both))
        return both

    def step(self, fit: Fit) -> Step:
        """All hypotheses at a fit."""
        return take_step(fit, self._pool(fit), self._smooth(fit), self.block)

    def _without_idle(self, fit: Fit) -> Fit:
        """The fit without causes that it does better without."""
        fit, gone = _pruned(fit, self.base)
        self._drop(gone)
        return fit

    def _drop(self, causes: list[Cause]) -> None:
        self.dropped += causes
        self.steps = [step for step in self.steps if step.taken not in causes]

    def _at(self, cause: Cause) -> int:
        return next(i for i, step in enumerate(self.steps) if step.taken == cause)

    def _pool(self, fit: Fit) -> list[Candidate]:
        weight = fit.weight_over(self.base)
        return [candidate.weighed(weight) for candidate in self.pool]

    def _smooth(self, fit: Fit) -> list[Family]:
        return [family.weighed(fit.weight_over(self.base)) for family in self.smooth]


def _pruned(fit: Fit, base: Fit) -> tuple[Fit, list[Cause]]:
    """Drop causes, the least needed first, while the evidence is higher without; those far from their null are not refitted without."""
    gone: list[Cause] = []
    while True:
        own = [cause for cause in fit.rig.effects if cause not in base.rig.effects]
        needs = {cause: fit.log_evidence_for(cause) for cause in own[:-1]}
        cause = min(needs, key=needs.__getitem__, default=None)
        if cause is None or needs[cause] > policy.SURELY_NEEDED:
            return fit, gone
        rig, rules = fit.rig.without_cause(cause), fit.posterior.model.rules
        best = fit_rig(rig, fit.observations, fit.values, rules, tolerance=policy.ROUGH_TOLERANCE)
        if best.log_evidence <= fit.log_evidence:
            return fit, gone
        gone.append(cause)
        fit = best
