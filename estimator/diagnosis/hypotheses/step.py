"""One step of the search: compare all hypotheses at a fit, and take the best cause if its evidence suffices.

"Nothing" and "something that no cause explains" are hypotheses of every step. The latter does not end the search, for the first of two
causes explains less than a flexible curve does; it counts at the end (`verdict`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch
from jaxtyping import Int

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.hypotheses.candidates import Candidate
from estimator.diagnosis.hypotheses.instants import at_finer_instant
from estimator.diagnosis.hypotheses.noise import noise_causes
from estimator.diagnosis.hypotheses.places import at_known_place, at_nearer_place
from estimator.diagnosis.hypotheses.screening import Reached, Screened, in_full, screening
from estimator.diagnosis.limits import Limits
from estimator.diagnosis.progress import Pace
from estimator.diagnosis.structure.cross_validation import HeldOut, held_out
from estimator.diagnosis.structure.discrepancy import Discrepancy, discrepancy
from estimator.diagnosis.structure.families.collection import Family
from estimator.diagnosis.structure.pull import Pull
from estimator.diagnosis.structure.scatter import Scatter
from estimator.effects import EFFECTS
from estimator.effects.stages import NoiseEffect
from estimator.rig.rig import Cause
from estimator.side_by_side import each, meanwhile

Blocks = Int[np.ndarray, " reading"]


@dataclass(frozen=True)
class Hypothesis:
    """One hypothesis of a step.

    Attributes:
        cause: None for `nothing` and `unexplained`.
        name: Label of the cause, or one of those words.
        log_bayes_factor: Against nothing.
        probability: Posterior probability among all hypotheses of the step.
        fit: With the cause; None where it was only screened.
        held_out: Cross-validation over blocks of positions; None without a fit, or where it does not apply.
    """

    cause: Cause | None
    name: str
    log_bayes_factor: float
    probability: float = 0.0
    fit: Fit | None = None
    held_out: HeldOut | None = None


@dataclass(frozen=True)
class Step:
    """All hypotheses at one fit, and the cause that was taken, if any.

    Attributes:
        hypotheses: Most probable first.
        taken: The cause that was added; None at the end of the search.
        credible: Credible set: the smallest that holds 95 % of the probability of all causes.
        discrepancy: Structure in the residual before the cause was added; None where it was not asked.
    """

    hypotheses: tuple[Hypothesis, ...]
    taken: Cause | None
    credible: tuple[Hypothesis, ...]
    discrepancy: Discrepancy | None

    @property
    def remainder(self) -> Discrepancy:
        """Structure in the residual before the cause was added, of a step that compared all hypotheses."""
        assert self.discrepancy is not None
        return self.discrepancy

    @property
    def taken_fit(self) -> Fit:
        """The fit with the cause that was taken."""
        return next(
            hypothesis.fit
            for hypothesis in self.hypotheses
            if hypothesis.cause == self.taken and hypothesis.fit is not None
        )


def take_step(
    fit: Fit,
    pool: Sequence[Candidate],
    smooth: list[Family],
    block: Blocks,
    limits: Limits,
    pace: Pace,
    is_piled: bool,
    remainder: Discrepancy | None = None,
    reached: Reached | None = None,
    left_out: Cause | None = None,
) -> Step:
    """Compare all hypotheses at a fit and choose the cause to take.

    Args:
        fit: With the causes taken so far.
        pool: Columns of every cause; causes that the fit has are left out.
        smooth: Families of flexible curves, for what no cause explains.
        block: Block number of each reading, for cross-validation.
        limits: Once they are reached, no further hypothesis is fitted.
        pace: Told of each fit.
        is_piled: Whether causes of many kinds have piled up: fewer are then fitted in full, and noise only where no other cause is left.
        remainder: Structure in the residual, where it is known already.
        reached: Where an earlier comparison has found causes.
        left_out: A cause that the fit had before; it is fitted in full again.
    """
    remainder = remainder or discrepancy(fit, smooth)
    screened = screening(fit, [c for c in pool if c.cause not in fit.rig.effects])
    least = least_log_evidence(len(screened))
    if not (is_piled or limits.is_over):
        screened = _at_nearer_places(fit, screened, least, reached or {})
    most_fitted = policy.MOST_FITTED_IN_A_PILE if is_piled else policy.MOST_FITTED
    causes = _leaders_in_full(fit, screened, least, most_fitted, limits, pace, reached, left_out)
    causes += _of_noise(fit, causes, least, is_piled, limits, reached)
    hypotheses = [
        Hypothesis(None, "nothing", 0.0),
        Hypothesis(None, "unexplained", remainder.log_bayes_factor),
        *each(lambda hypothesis: _cross_validated(fit, hypothesis, block), causes),
    ]
    return _step_that_takes(with_probabilities(hypotheses, len(screened)), remainder, screened, least)


def _at_nearer_places(
    fit: Fit, screened: Mapping[Cause, Screened], least: float, reached: Reached
) -> dict[Cause, Screened]:
    """What was screened, with those causes at their best places that could be the best one there."""
    rows = {
        cause: at_known_place(fit, row, reached[cause]) if cause in reached else row
        for cause, row in screened.items()
    }
    bar = max((row.highest for row in rows.values()), default=0.0)
    asked = {
        cause: row for cause, row in rows.items() if policy.MOST_LOST_AWAY * row.highest > max(bar, least)
    }
    nearer = each(partial(at_nearer_place, fit), list(asked.values()))
    return {**rows, **dict(zip(asked, nearer, strict=True))}


def _leaders_in_full(
    fit: Fit,
    screened: Mapping[Cause, Screened],
    least: float,
    most_fitted: int,
    limits: Limits,
    pace: Pace,
    reached: Reached | None,
    left_out: Cause | None,
) -> list[Hypothesis]:
    """All screened causes; the leaders, and those that could still be the best one, by a full fit."""
    ranked = sorted(screened, key=lambda cause: -screened[cause].log_bayes_factor)
    nearest = max((row.highest for row in screened.values()), default=0.0)
    # What is linear cannot be taken, so that a full fit would change nothing.
    is_quiet = nearest < least - policy.MOST_GAINED_IN_FULL
    hypotheses = list[Hypothesis]()
    best, n_fitted, pictured = 0.0, 0, set[str]()
    begun = dict[int, Callable[[], tuple[float, Fit]]]()  # by the identity of where each starts
    for i, cause in enumerate(ranked):
        row = screened[cause]
        if (
            i < most_fitted
            and policy.MOST_LOST_BETWEEN * row.highest > max(best, least)
            and not limits.is_over
        ):
            row = at_finer_instant(fit, row)
        value, highest, start = row
        effect, fitted = EFFECTS[cause.name], None
        # The shapes of another picture of the same thing move far in a fit, as those of the first did.
        is_rival = effect.idealises in pictured and highest > 0.0
        is_asked = is_rival or cause == left_out or (fit.is_bent and effect.starts_far_off)
        is_known = is_quiet and not is_asked and _is_linear(start, fit)
        is_worth_it = is_asked or _is_worth_a_fit(i, highest, best, most_fitted)
        if is_worth_it and not is_known and not limits.is_over:
            later = [
                screened[other]
                for k, other in enumerate(ranked[i + 1 :], i + 1)
                if _is_worth_a_fit(k, screened[other].highest, best, most_fitted)
            ]
            pace.tell(n_fitted, n_fitted + 1 + len(later))
            following = later[0] if later else None
            if following is not None and id(following.start) not in begun:
                # Another core begins it, though what this one finds may rule it out.
                begun[id(following.start)] = meanwhile(
                    partial(in_full, fit, following.log_bayes_factor, following.start, reached)
                )
            in_time = begun.get(id(start))
            value, fitted = in_time() if in_time else in_full(fit, value, start, reached)
            best, n_fitted = max(best, value), n_fitted + 1
            pictured |= {effect.idealises} if effect.idealises is not None else set()
        hypotheses.append(Hypothesis(cause, cause.label, value, fit=fitted))
    pace.tell(n_fitted, n_fitted)
    return hypotheses


def _of_noise(
    fit: Fit,
    others: Sequence[Hypothesis],
    least: float,
    is_piled: bool,
    limits: Limits,
    reached: Reached | None,
) -> list[Hypothesis]:
    """Causes that change how readings scatter: by a full fit where they come near the best other cause.

    In a pile they are fitted only where no other cause suffices.
    """
    highest = max((h.log_bayes_factor for h in others if h.fit is not None), default=0.0)
    is_earned = highest > least
    worth_a_fit = highest - policy.LEADERS_WITHIN if is_earned else 0.0
    if limits.is_over or (is_piled and is_earned):
        worth_a_fit = math.inf
    rows = noise_causes(fit, worth_a_fit, reached)
    return [Hypothesis(cause, cause.label, value, fit=full) for cause, value, full in rows]


def _step_that_takes(
    hypotheses: Sequence[Hypothesis],
    remainder: Discrepancy,
    screened: Mapping[Cause, Screened],
    least: float,
) -> Step:
    """The step with these hypotheses, given most probable first, and the cause that it takes, if the evidence for one suffices."""
    causes = [hypothesis for hypothesis in hypotheses if hypothesis.cause is not None]
    if not causes:
        return Step(tuple(hypotheses), None, (), remainder)
    earning = [hypothesis for hypothesis in causes if _earns(hypothesis, least)]
    choice = _choice(earning, remainder, lambda first, beside: _earns_beside(first, beside, screened, least))
    if choice and choice.name != causes[0].name:
        causes = [
            hypothesis for hypothesis in causes if not is_noise(hypothesis.cause) or hypothesis == choice
        ]
    taken = None if choice is None else choice.cause
    return Step(tuple(hypotheses), taken, credible_set(causes, taken), remainder)


def _is_worth_a_fit(i: int, highest: float, best: float, most: int) -> bool:
    """Whether a cause at a place of the screening is fitted in full, given its best start there and the best that was fitted."""
    is_leader = i < min(policy.MOST_LEADERS, most) and highest > max(best - policy.LEADERS_WITHIN, 0.0)
    could_be_best = i < most and highest > max(best, 0.0)
    return is_leader or could_be_best


def _is_linear(start: Candidate, fit: Fit) -> bool:
    """Whether the linear model says of a cause what a full fit would: it starts at its null, and has no shapes."""
    extent = fit.posterior.model.circumstances.extent
    has_shapes = any(quantity.is_shape for quantity in EFFECTS[start.cause.name].quantities(extent))
    return not has_shapes and start.is_at_null


def least_log_evidence(n_causes: int) -> float:
    """Log Bayes factor against nothing that a cause needs to be taken, among so many causes."""
    return (
        policy.LEAST_LOG_ODDS + policy.LOG_PRIOR_NOTHING - policy.LOG_PRIOR_CAUSE + math.log(max(n_causes, 1))
    )


def leaves_structure(remainder: Discrepancy | Scatter | Pull) -> bool:
    """Whether the posterior odds favour something unexplained in the residual."""
    return _log_odds_left(remainder) > policy.LEAST_LOG_ODDS_LEFT


def p_of_structure(remainder: Discrepancy | Scatter | Pull) -> float:
    """Posterior probability that something unexplained is in the residual."""
    return 1.0 / (1.0 + math.exp(-min(max(_log_odds_left(remainder), -700.0), 700.0)))


def _log_odds_left(remainder: Discrepancy | Scatter | Pull) -> float:
    return remainder.log_bayes_factor + policy.LOG_PRIOR_UNEXPLAINED - policy.LOG_PRIOR_NOTHING


def _cross_validated(fit: Fit, hypothesis: Hypothesis, block: Blocks) -> Hypothesis:
    """The hypothesis, cross-validated over blocks where it was fitted."""
    effect = None if hypothesis.cause is None else EFFECTS[hypothesis.cause.name]
    if hypothesis.fit is None or (isinstance(effect, NoiseEffect) and effect.is_contaminating):
        return hypothesis  # blocks are predicted with normal densities
    return replace(hypothesis, held_out=held_out(fit, hypothesis.fit, block))


def _choice(
    earning: list[Hypothesis], remainder: Discrepancy, stands: Callable[[Hypothesis, Hypothesis], bool]
) -> Hypothesis | None:
    """The cause to take among those with sufficient evidence, given best first.

    Scatter that imitates structure, such as that of a mover, is taken only when no other cause is left; or where it leads by far, before
    any curve too, and nothing is left of the best other cause beside it. Outliers spoil all other evidence: where they lead, they win.

    Args:
        earning: Causes.
        remainder: Structure in the residual.
        stands: Whether the first cause has sufficient evidence beside the second.
    """
    structured = next((hypothesis for hypothesis in earning if not is_noise(hypothesis.cause)), None)
    leader = next(iter(earning), None)
    effect = None if leader is None or leader.cause is None else EFFECTS[leader.cause.name]
    is_last = isinstance(effect, NoiseEffect) and effect.imitates_structure
    if leader is None or structured is None or not is_last:
        return leader
    rival = max(structured.log_bayes_factor, remainder.log_bayes_factor)
    leads_by_far = leader.log_bayes_factor > rival + policy.LEADERS_WITHIN
    return leader if leads_by_far and not stands(structured, leader) else structured


def _earns_beside(
    hypothesis: Hypothesis, beside: Hypothesis, screened: Mapping[Cause, Screened], least: float
) -> bool:
    """Whether the evidence for a cause suffices beside another, by a full fit with both."""
    assert hypothesis.cause is not None
    assert beside.fit is not None
    value, _, start = screened[hypothesis.cause]
    return in_full(beside.fit, value, start)[0] > least


def _earns(hypothesis: Hypothesis, least: float) -> bool:
    """Whether the evidence for a cause suffices, and cross-validation does not contradict it."""
    is_loss = hypothesis.held_out is not None and hypothesis.held_out.is_loss
    return hypothesis.fit is not None and hypothesis.log_bayes_factor > least and not is_loss


def is_noise(cause: Cause | None) -> bool:
    """Whether a cause changes no prediction, only how readings scatter."""
    return cause is not None and isinstance(EFFECTS[cause.name], NoiseEffect)


def with_probabilities(hypotheses: Sequence[Hypothesis], n_causes: int) -> list[Hypothesis]:
    """The hypotheses with their posterior probabilities, most probable first."""
    log_prior = {"nothing": policy.LOG_PRIOR_NOTHING, "unexplained": policy.LOG_PRIOR_UNEXPLAINED}
    log_prior_each = policy.LOG_PRIOR_CAUSE - math.log(max(n_causes, 1))
    log_posterior = torch.tensor(
        [h.log_bayes_factor + log_prior.get(h.name, log_prior_each) for h in hypotheses], dtype=torch.float64
    )
    probability = torch.softmax(log_posterior, 0).tolist()
    order = torch.argsort(log_posterior, descending=True, stable=True).tolist()
    return [replace(hypotheses[i], probability=probability[i]) for i in order]


def shares_of(causes: Sequence[Hypothesis]) -> list[float]:
    """Probabilities of causes among each other, without `nothing` and `unexplained`."""
    log_bayes_factors = torch.tensor(
        [hypothesis.log_bayes_factor for hypothesis in causes], dtype=torch.float64
    )
    return list(torch.softmax(log_bayes_factors, 0).tolist())


def credible_set(causes: Sequence[Hypothesis], taken: Cause | None) -> tuple[Hypothesis, ...]:
    """The smallest set that holds 95 % of the probability of all causes, given most probable first; always with the one that was taken.

    Causes no better than nothing are left out, for many of them together may hold some per cent.
    """
    cumulative = torch.cumsum(torch.tensor(shares_of(causes), dtype=torch.float64), 0)
    n = int((cumulative < policy.CREDIBLE_SHARE).sum()) + 1
    return tuple(
        hypothesis
        for i, hypothesis in enumerate(causes)
        if hypothesis.cause == taken or (i < n and hypothesis.log_bayes_factor > 0.0)
    )
