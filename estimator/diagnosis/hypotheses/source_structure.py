"""Whether the source is built otherwise than described, which is asked where causes of many kinds pile up.

A wrong picture of a winding looks like a little of many causes. A search that takes the best of them one at a time never comes back to the
one hypothesis that would do for all.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.hypotheses.candidates import NO_CHANGE, Candidate
from estimator.diagnosis.hypotheses.screening import screening
from estimator.diagnosis.hypotheses.several_places import fit_with_needed, joint_evidence
from estimator.diagnosis.hypotheses.step import (
    Hypothesis,
    Step,
    credible_set,
    least_log_evidence,
    with_probabilities,
)
from estimator.diagnosis.limits import Limits
from estimator.diagnosis.progress import Pace
from estimator.diagnosis.structure.discrepancy import Discrepancy
from estimator.effects import EFFECTS
from estimator.effects.attach import with_effect
from estimator.effects.stages import SourceEffect, WindingEffect
from estimator.rig.rig import Cause
from estimator.side_by_side import each

# Of the log evidence of a pile; what explains less alone is not what the pile stands in for.
WORTH_A_START = 0.05
NEARLY_THE_SAME = 1.0  # in log density: a climb that ends so far below the pile leads to a lower maximum


@dataclass(frozen=True)
class Asked:
    """One hypothesis of structure, asked in place of a pile of causes.

    Attributes:
        cause: Name and place.
        log_bayes_factor: Against nothing, with the causes that it leaves needed, each of which costs its prior odds.
        needed: Causes of the pile that are needed beside it.
        alone: Fit with it alone.
    """

    cause: Cause
    log_bayes_factor: float
    needed: tuple[Cause, ...]
    alone: Fit


@dataclass(frozen=True)
class OtherStructures:
    """A pile of causes, and what the hypotheses of structure reached in its place.

    Attributes:
        pile: Its causes.
        log_bayes_factor: Of the pile, counted as that of a hypothesis.
        asked: The hypotheses, best first.
    """

    pile: tuple[Cause, ...]
    log_bayes_factor: float
    asked: tuple[Asked, ...]

    @property
    def better(self) -> Asked | None:
        """The best hypothesis that explains more than the pile by no more causes; None where there is none."""
        explaining = (
            hypothesis for hypothesis in self.asked if hypothesis.log_bayes_factor > self.log_bayes_factor
        )
        return next(
            (hypothesis for hypothesis in explaining if len(hypothesis.needed) < len(self.pile)), None
        )

    def step(self, base: Fit, pool: Sequence[Candidate], remainder: Discrepancy) -> Step:
        """The comparison that takes the better one: hypotheses of structure by what they reached, all others as screened.

        Args:
            base: Without any cause.
            pool: Columns of every cause there.
            remainder: Structure in its residual.
        """
        of_structure = {hypothesis.cause for hypothesis in self.asked}
        screened = screening(base, [c for c in pool if c.cause not in of_structure])
        hypotheses = [
            Hypothesis(None, "nothing", 0.0),
            Hypothesis(None, "unexplained", remainder.log_bayes_factor),
            *(
                Hypothesis(trial.cause, trial.cause.label, trial.log_bayes_factor, fit=trial.alone)
                for trial in self.asked
            ),
            *(Hypothesis(cause, cause.label, value) for cause, (value, _, _) in screened.items()),
        ]
        ranked = with_probabilities(hypotheses, len(hypotheses) - 2)
        taken = None if self.better is None else self.better.cause
        causes = [hypothesis for hypothesis in ranked if hypothesis.cause is not None]
        return Step(tuple(ranked), taken, credible_set(causes, taken), remainder)


def is_pile(causes: Sequence[Cause], most: int) -> bool:
    """Whether there are more than so many different kinds of causes; one kind at several places counts once."""
    return len({cause.name for cause in causes}) > most


def other_structures(
    base: Fit, pile: Fit, pool: Sequence[Candidate], limits: Limits, pace: Pace
) -> OtherStructures:
    """Every hypothesis of structure, fitted alone from all its starts, then with what it leaves needed of a pile of causes.

    The linear model says which to fit first with the pile, for where time is limited. It is no bound: in MICE run07 full fits of all took
    another one than those of its best sixteen.

    Args:
        base: Without any cause.
        pile: With causes of many kinds.
        pool: Columns of every cause at the base.
        limits: Say which hypotheses are asked; once they are reached, no further one is.
        pace: Told of each hypothesis.
    """
    n_causes = len({candidate.cause for candidate in pool})
    prior_cost = math.log(max(n_causes, 1)) + policy.LOG_PRIOR_NOTHING - policy.LOG_PRIOR_CAUSE
    least = least_log_evidence(n_causes)
    worth = _worth_a_start(base, pile, least)
    piled = tuple(cause for cause in pile.rig.effects if cause not in base.rig.effects)

    def log_bayes_factor(log_evidence: float, n_added: int) -> float:
        return log_evidence - base.log_evidence - (n_added - 1) * prior_cost

    def asked_alone(cause: Cause) -> Asked | None:
        fit = None if limits.is_over else _best_alone(base, cause, worth)
        if fit is None or _changes_nothing(base, fit, cause):
            return None
        starts = _starts(base, fit, pool, [c for c in piled if c != cause])
        gain, needed = joint_evidence(fit, starts, least) if starts else (0.0, [])
        value = log_bayes_factor(fit.log_evidence + gain, 1 + len(needed))
        return Asked(cause, value, tuple(start.cause for start in needed), fit)

    def asked_with_needed(trial: Asked) -> Asked | None:
        if limits.is_over:
            return None
        others = [c for c in piled if c != trial.cause]
        beside = _with_needed(base, trial, pile, others, least)
        needed = tuple(c for c in others if c in beside.rig.effects)
        value = log_bayes_factor(beside.log_evidence, 1 + len(needed))
        return replace(trial, log_bayes_factor=value, needed=needed)

    trials, asked = list[Asked](), list[Asked]()
    causes = structural_causes(base, limits)
    for i, trial in enumerate(each(asked_alone, causes)):
        pace.tell(i, 2 * len(causes))
        trials += [] if trial is None else [trial]
    trials.sort(key=lambda trial: -trial.log_bayes_factor)
    for i, trial in enumerate(each(asked_with_needed, trials)):
        pace.tell(len(causes) + i, len(causes) + len(trials))
        asked += [] if trial is None else [trial]
    asked.sort(key=lambda trial: -trial.log_bayes_factor)
    result = OtherStructures(piled, log_bayes_factor(pile.log_evidence, len(piled)), tuple(asked))
    if result.better is None:
        return result
    alone, rules = result.better.alone, base.posterior.model.rules
    to_the_end = fit_rig(alone.rig, alone.observations, alone.values, rules, near=alone)
    asked = [replace(trial, alone=to_the_end) if trial is result.better else trial for trial in asked]
    return replace(result, asked=tuple(asked))


def _starts(base: Fit, alone: Fit, pool: Sequence[Candidate], causes: Sequence[Cause]) -> list[Candidate]:
    """The best start of each of some causes in the linear model at a fit; those that start away from their null are left out."""
    weight = alone.weight_over(base)
    near = [c.weighed(weight) for c in pool if c.cause in causes and c.is_at_null]
    return [row.start for row in screening(alone, near).values()]


def structural_causes(base: Fit, limits: Limits) -> list[Cause]:
    """Hypotheses of structure that the rig of a fit does not have, that concern the session and that the limits allow."""
    circumstances = base.posterior.model.circumstances
    idle = _idle_coils(base)
    return [
        cause
        for name, effect in EFFECTS.items()
        if effect.is_structural and limits.allows(effect)
        for place in effect.places(base.rig)
        if not (isinstance(effect, WindingEffect | SourceEffect) and place in idle)
        and (cause := Cause(name, place)) not in base.rig.effects
        and effect.concerns(circumstances, place)
    ]


def _idle_coils(fit: Fit) -> set[str]:
    """Coils that carry no current in any reading, so that it does not matter how they are wound."""
    model = fit.posterior.model
    delivered_A = model.sources.delivered_A(model.circumstances.current_A, fit.values)
    is_idle = (delivered_A == 0.0).flatten(end_dim=-2).all(0)
    return {coil.name for coil, idle in zip(fit.rig.coils, is_idle.tolist(), strict=True) if idle}


def _worth_a_start(base: Fit, pile: Fit, least: float) -> float:
    """Log evidence from which on a hypothesis of structure alone explains part of what a pile does."""
    return max(least, WORTH_A_START * (pile.log_evidence - base.log_evidence))


def _best_alone(base: Fit, cause: Cause, worth: float) -> Fit | None:
    """The fit with a cause from the best of its starts; None where it is no longer itself from any.

    Climbs that cannot rise by what is worth a start end early.
    """
    fits = []
    to_beat = float(base.optimum.log_posterior) + worth
    for shapes in EFFECTS[cause.name].starts(base.posterior.model.circumstances, cause.place):
        rig = with_effect(base.rig, cause, base.observations, shapes)
        rules = base.posterior.model.rules
        fit = fit_rig(
            rig,
            base.observations,
            base.start_with(rig),
            rules,
            tolerance=policy.STRUCTURE_TOLERANCE,
            to_beat=to_beat,
        )
        to_beat = max(to_beat, float(fit.optimum.log_posterior))
        if math.isfinite(fit.log_evidence) and fit.still_has(cause):
            fits.append(fit)
    return max(fits, key=lambda fit: fit.log_evidence, default=None)


def _changes_nothing(base: Fit, alone: Fit, cause: Cause) -> bool:
    """Whether a cause changes no prediction, neither as it is fitted nor to first order: of a coil without current, for one."""
    own = [
        i for i, name in enumerate(alone.posterior.coordinates.names) if name.startswith(f"{cause.label}.")
    ]
    with torch.no_grad():
        without_T = base.posterior.measured_components(base.posterior.model.predict(alone.values))
    change = (alone.predicted_T - without_T) * alone.whitening_per_T
    columns = alone.jacobian[:, own] * alone.posterior.coordinates.scale[own]
    return all(float(each.abs().max()) < NO_CHANGE for each in (change, columns) if each.numel())


def _with_needed(base: Fit, trial: Asked, pile: Fit, others: Sequence[Cause], least: float) -> Fit:
    """The fit with those causes of a pile whose evidence suffices beside a hypothesis of structure.

    It starts from the pile, which has moved all numbers to where the readings want them. Where the hypothesis alone explains part of what
    the pile does, it starts at what it is alone, and the fit with it alone is another start, for in a pile other causes have already taken
    its place. Elsewhere it starts at its null; what has no size, and so no null, is not fitted.
    """
    cause, label = trial.cause, f"{trial.cause.label}."
    rig = pile.rig.without_cause(cause) if cause in pile.rig.effects else pile.rig
    rig = rig.with_cause(cause, [p for n, p in trial.alone.rig.parameters.items() if n.startswith(label)])
    own = {name: value for name, value in trial.alone.values.items() if name.startswith(label)}
    is_worth = trial.alone.log_evidence - base.log_evidence > _worth_a_start(base, pile, least)
    if not is_worth:
        null = trial.alone.null_values(cause)
        if not null:
            return trial.alone
        own |= {name: value for name, value in null.items() if not rig.parameters[name].is_positive}
    to_beat = float(pile.optimum.log_posterior) - NEARLY_THE_SAME  # where the hypothesis changes nothing
    tolerance = policy.STRUCTURE_TOLERANCE
    fits = [fit_with_needed(pile, rig, others, least, {**pile.values, **own}, to_beat, tolerance)]
    if is_worth:
        fits.append(fit_with_needed(trial.alone, rig, others, least, to_beat=to_beat, tolerance=tolerance))
    return max((trial.alone if fit is pile else fit for fit in fits), key=lambda fit: fit.log_evidence)
