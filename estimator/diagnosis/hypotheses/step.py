"""One step of the search: all hypotheses at a fit with their probabilities, and the cause that earns its place, if one does.

"Nothing" and "something that no cause explains" are in the race at every step; the latter does not end it, for the first of two causes
explains less than a flexible curve does. It has its say at the end (`verdict`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Int

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.hypotheses.candidates import Candidate
from estimator.diagnosis.hypotheses.noise import noise_causes
from estimator.diagnosis.hypotheses.screening import in_full, screening
from estimator.diagnosis.structure.cross_validation import HeldOut, held_out
from estimator.diagnosis.structure.discrepancy import Discrepancy, Family, discrepancy
from estimator.effects import EFFECTS
from estimator.effects.base import NoiseEffect
from estimator.rig.rig import Cause

Blocks = Int[np.ndarray, " reading"]


@dataclass(frozen=True)
class Rival:
    """One hypothesis of a step.

    Attributes:
        cause: None for `nothing` and `unexplained`.
        name: Label of the cause, or one of those words.
        log_bayes_factor: Against nothing.
        probability: Among all hypotheses of the step.
        fit: Where it was fitted in full.
        held_out: What it gains on blocks of places that are predicted from the others; where it was fitted in full.
    """

    cause: Cause | None
    name: str
    log_bayes_factor: float
    probability: float = 0.0
    fit: Fit | None = None
    held_out: HeldOut | None = None


@dataclass(frozen=True)
class Step:
    """One cause taken, or the reason to stop.

    Attributes:
        rivals: All hypotheses, most probable first.
        taken: The cause that was added; None at the end.
        credible: The smallest set of causes that holds 95 % of the probability of all causes.
    """

    rivals: tuple[Rival, ...]
    taken: Cause | None
    credible: tuple[Rival, ...]
    left: Discrepancy

    @property
    def winner(self) -> Fit:
        """The fit with the cause that was taken."""
        return next(rival.fit for rival in self.rivals if rival.cause == self.taken and rival.fit is not None)


def take_step(fit: Fit, pool: Sequence[Candidate], smooth: list[Family], block: Blocks) -> Step:
    """All hypotheses at a fit, and which cause to take.

    Args:
        fit: With the causes that were taken so far.
        pool: Columns of every cause at the base; those of causes that the fit has are left out.
        smooth: Families of flexible curves, for what no cause explains.
        block: Number of the block of every reading, for the gain on unseen places.
    """
    present = set(fit.rig.effects)
    left = discrepancy(fit, smooth)
    screened = screening(fit, [c for c in pool if c.cause not in present])
    ranked = sorted(screened, key=lambda cause: -screened[cause][0])
    rivals = [Rival(None, "nothing", 0.0), Rival(None, "unexplained", left.log_bayes_factor)]
    best = 0.0
    for i, cause in enumerate(ranked):
        value, highest, start = screened[cause]
        fitted = None
        if i < policy.MOST_LEADERS and highest > max(best - policy.LEADERS_WITHIN, 0.0):
            value, fitted = in_full(fit, value, start)
            best = max(best, value)
        rivals.append(Rival(cause, cause.label, value, fit=fitted))
    least = least_log_evidence(len(ranked))
    beside = max((r.log_bayes_factor for r in rivals if r.fit is not None), default=0.0)
    noisy = noise_causes(fit, beside - policy.LEADERS_WITHIN if beside > least else 0.0)
    rivals += [Rival(cause, cause.label, value, fit=full) for cause, value, full in noisy]
    rivals = with_probabilities([_judged(fit, rival, block) for rival in rivals], len(ranked))
    causes = [rival for rival in rivals if rival.cause is not None]
    if not causes:
        return Step(tuple(rivals), None, (), left)
    earning = [rival for rival in causes if _earns(rival, least)]
    first = _first(earning)
    if first and first.name != next(rival.name for rival in causes):
        causes = [rival for rival in causes if not _is_noise(rival) or rival == first]
    taken = None if first is None else first.cause
    return Step(tuple(rivals), taken, credible_set(causes, taken), left)


def least_log_evidence(n_causes: int) -> float:
    """What a cause needs against nothing to be taken, where so many are asked."""
    return (
        policy.LEAST_LOG_ODDS + policy.LOG_PRIOR_NOTHING - policy.LOG_PRIOR_CAUSE + math.log(max(n_causes, 1))
    )


def leaves_structure(left: Discrepancy) -> bool:
    """Whether the odds are that something is left which no cause explains."""
    return (
        left.log_bayes_factor + policy.LOG_PRIOR_UNEXPLAINED - policy.LOG_PRIOR_NOTHING
        > policy.LEAST_LOG_ODDS_LEFT
    )


def _judged(fit: Fit, rival: Rival, block: Blocks) -> Rival:
    """A rival that was fitted, with what it gains on unseen blocks."""
    effect = None if rival.cause is None else EFFECTS[rival.cause.name]
    if rival.fit is None or (isinstance(effect, NoiseEffect) and effect.is_contaminating):
        return rival  # blocks are predicted with normal densities
    return replace(rival, held_out=held_out(fit, rival.fit, block))


def _first(earning: list[Rival]) -> Rival | None:
    """What to take of the causes that earn their place, best first.

    Scatter that imitates structure, such as that of a mover, waits: everything else is asked before it, and again beside it. Outliers spoil
    all other evidence: where they lead, and the mover does not explain them better, they come first.
    """
    structured = [rival for rival in earning if not _is_noise(rival)]
    leader = next(iter(earning), None)
    effect = None if leader is None or leader.cause is None else EFFECTS[leader.cause.name]
    has_to_wait = isinstance(effect, NoiseEffect) and effect.imitates_structure
    return structured[0] if has_to_wait and structured else leader


def _earns(rival: Rival, least: float) -> bool:
    """Whether the evidence for a cause suffices, and unseen blocks do not speak against it."""
    is_loss = rival.held_out is not None and rival.held_out.is_loss
    return rival.fit is not None and rival.log_bayes_factor > least and not is_loss


def _is_noise(rival: Rival) -> bool:
    return rival.cause is not None and isinstance(EFFECTS[rival.cause.name], NoiseEffect)


def with_probabilities(rivals: Sequence[Rival], n_causes: int) -> list[Rival]:
    """Rivals with their probabilities among each other, most probable first."""
    log_prior = {"nothing": policy.LOG_PRIOR_NOTHING, "unexplained": policy.LOG_PRIOR_UNEXPLAINED}
    each = policy.LOG_PRIOR_CAUSE - math.log(max(n_causes, 1))
    logs = torch.tensor(
        [r.log_bayes_factor + log_prior.get(r.name, each) for r in rivals], dtype=torch.float64
    )
    shares = torch.softmax(logs, 0).tolist()
    order = torch.argsort(logs, descending=True, stable=True).tolist()
    return [replace(rivals[i], probability=shares[i]) for i in order]


def shares_of(causes: Sequence[Rival]) -> list[float]:
    """Probabilities of causes among each other, however small they are beside nothing and unexplained."""
    logs = torch.tensor([rival.log_bayes_factor for rival in causes], dtype=torch.float64)
    return list(torch.softmax(logs, 0).tolist())


def credible_set(causes: Sequence[Rival], taken: Cause | None) -> tuple[Rival, ...]:
    """The smallest set that holds 95 % of the probability of all causes, and the one that was taken in any case.

    What explains no more than nothing does is left out: many such together may hold some per cent.
    """
    reached = torch.cumsum(torch.tensor(shares_of(causes), dtype=torch.float64), 0)
    n = int((reached < policy.CREDIBLE_SHARE).sum()) + 1
    return tuple(
        rival
        for i, rival in enumerate(causes)
        if rival.cause == taken or (i < n and rival.log_bayes_factor > 0.0)
    )
