"""Naming causes: screen all at once, fit the leaders, take the best where it earns its place, and begin again.

"Nothing" and "something that no cause explains" are in the race at every step; the latter does not end it, for the first of two causes
explains less than a flexible curve does. It has its say at the end (`verdict`). Causes taken earlier are asked again in the presence of
the others.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from estimator.diagnosis.candidates import Candidate, candidates, causes_of
from estimator.diagnosis.discrepancy import Discrepancy, Family, discrepancy, families
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.linear import log_bayes_factor, log_mean_exp
from estimator.diagnosis.noise import noise_causes
from estimator.effects import EFFECTS
from estimator.effects.attach import with_effect
from estimator.effects.base import NoiseEffect
from estimator.rig import Cause

LOG_PRIOR_NOTHING = math.log(0.4)
LOG_PRIOR_CAUSE = math.log(0.3)  # shared by all causes
LOG_PRIOR_UNEXPLAINED = math.log(0.3)
LEAST_LOG_ODDS = math.log(20.0)  # against nothing, for a cause to be taken
LEAST_LOG_ODDS_LEFT = math.log(10.0)  # for something to be left that no cause explains
CREDIBLE = 0.95
MOST_LEADERS = 4
LEADERS_WITHIN = 10.0  # of the best in log evidence of the screening
MOST_CAUSES = 20
SURELY_NEEDED = 15.0  # log evidence for a cause by its distance from the null
MOST_REVISITED = 4  # with more causes than that, each is only asked whether it is still needed


@dataclass(frozen=True)
class Rival:
    """One hypothesis of a step.

    Attributes:
        cause: None for `nothing` and `unexplained`.
        name: Label of the cause, or one of those words.
        log_bayes_factor: Against nothing.
        probability: Among all hypotheses of the step.
        fit: Where it was fitted in full.
    """

    cause: Cause | None
    name: str
    log_bayes_factor: float
    probability: float = 0.0
    fit: Fit | None = None


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


@dataclass(frozen=True)
class Search:
    """How the causes were found.

    Attributes:
        base, final: Fits before and after.
        steps: In order; the last one took nothing.
        dropped: Causes that were taken and later no longer earned their place.
        pool: Columns of every cause at the base.
        whole: The discrepancy at the base.
    """

    base: Fit
    final: Fit
    steps: tuple[Step, ...]
    dropped: tuple[Cause, ...]
    pool: tuple[Candidate, ...]
    whole: Discrepancy

    @property
    def log_odds(self) -> float:
        """Of all that was taken, against nothing."""
        n = len(self.final.rig.effects) - len(self.base.rig.effects)
        each = LOG_PRIOR_CAUSE - math.log(len({c.cause for c in self.pool})) - LOG_PRIOR_NOTHING
        return self.final.log_evidence - self.base.log_evidence + n * each


def search(base: Fit, tell: Callable[[str], None]) -> Search:
    """Add causes to a fit while they earn it, then ask of each again whether another would do better beside the others.

    Args:
        base: The rig as it is described, fitted.
        tell: Told what is going on, step by step.
    """
    pool = candidates(base, causes_of(base.rig, base))
    trail = _Trail(base, pool, families(base), tell)
    whole = discrepancy(base, trail.smooth)
    fit = trail.forward(base)
    if 1 < len(trail.own(fit)) <= MOST_REVISITED:
        fit = trail.forward(trail.revisited(fit))
    if len(trail.own(fit)) == 1 and leaves_structure(trail.steps[-1].left):
        fit = trail.with_alternative(fit)
    return Search(base, fit, tuple(trail.steps), tuple(trail.dropped), tuple(pool), whole)


def leaves_structure(left: Discrepancy) -> bool:
    """Whether the odds are that something is left which no cause explains."""
    return left.log_bayes_factor + LOG_PRIOR_UNEXPLAINED - LOG_PRIOR_NOTHING > LEAST_LOG_ODDS_LEFT


class _Trail:
    """The steps of a search, with what all of them share: columns of the causes, smooth families."""

    def __init__(
        self, base: Fit, pool: list[Candidate], smooth: list[Family], tell: Callable[[str], None]
    ) -> None:
        self.base, self.pool, self.smooth = base, pool, smooth
        self.tell = tell
        self.steps: list[Step] = []
        self.dropped: list[Cause] = []

    def own(self, fit: Fit) -> list[Cause]:
        """Causes of a fit beyond the base."""
        return [cause for cause in fit.rig.effects if cause not in self.base.rig.effects]

    def forward(self, fit: Fit) -> Fit:
        """Take causes until none earns its place."""
        self.steps = [step for step in self.steps if step.taken in self.own(fit)]
        while True:
            step = _step(fit, self.pool, self.smooth)
            self.steps.append(step)
            if step.taken is None or len(self.own(fit)) >= MOST_CAUSES:
                return fit
            self.tell(
                f"{step.taken.label} earns its place ({step.winner.log_evidence - fit.log_evidence:+.1f} in log evidence)"
            )
            fit = self._weighed_anew(step)
            fit, gone = _without_idle(fit, self.base)
            self.dropped += gone
            if step.taken in gone:
                return fit

    def revisited(self, fit: Fit) -> Fit:
        """Each cause again, in the presence of the others: exchanged where another does better, dropped where none is needed."""
        for cause in self.own(fit):
            without = fit_rig(
                fit.rig.without_cause(cause), fit.observations, fit.values, fit.posterior.chain.rules
            )
            self.tell(f"{cause.label} again, beside the others")
            step = _step(without, self.pool, self.smooth)
            at = next(i for i, old in enumerate(self.steps) if old.taken == cause)
            if step.taken is None:
                self.dropped.append(cause)
                fit = without
            else:
                self.steps[at] = step
                fit = fit if step.taken == cause else step.winner
        return fit

    def with_alternative(self, fit: Fit) -> Fit:
        """Where the one cause that was taken leaves structure, another of its credible set that leaves none."""
        step = self.steps[0]
        for rival in step.credible:
            if rival.fit is None or rival.cause == step.taken:
                continue
            if not leaves_structure(discrepancy(rival.fit, self.smooth)):
                self.tell(f"{rival.name} in its place leaves less")
                self.steps = [replace(step, taken=rival.cause)]
                return self.forward(rival.fit)
        return fit

    def _weighed_anew(self, step: Step) -> Fit:
        """The winner; a cause of scatter changes what all readings weigh."""
        fit = step.winner
        if step.taken is not None and isinstance(EFFECTS[step.taken.name], NoiseEffect):
            self.pool, self.smooth = candidates(fit, causes_of(self.base.rig, fit)), families(fit)
        return fit


def _step(fit: Fit, pool: list[Candidate], smooth: list[Family]) -> Step:
    present = set(fit.rig.effects)
    left = discrepancy(fit, smooth)
    screened = screening(fit, [c for c in pool if c.cause not in present])
    best = max((value for value, _ in screened.values()), default=-math.inf)
    ranked = sorted(screened, key=lambda cause: -screened[cause][0])
    rivals = [Rival(None, "nothing", 0.0), Rival(None, "unexplained", left.log_bayes_factor)]
    for i, cause in enumerate(ranked):
        value, start = screened[cause]
        fitted = None
        if i < MOST_LEADERS and value > max(best - LEADERS_WITHIN, 0.0):
            value, fitted = _in_full(fit, value, start)
        rivals.append(Rival(cause, cause.label, value, fit=fitted))
    least = LEAST_LOG_ODDS - LOG_PRIOR_CAUSE + math.log(max(len(ranked), 1)) + LOG_PRIOR_NOTHING
    beside = max((r.log_bayes_factor for r in rivals if r.fit is not None), default=0.0)
    noisy = noise_causes(fit, beside if beside > least else 0.0)
    rivals += [Rival(cause, cause.label, value, fit=full) for cause, value, full in noisy]
    rivals = _with_probabilities(rivals, len(ranked))
    causes = [rival for rival in rivals if rival.cause is not None]
    if not causes:
        return Step(tuple(rivals), None, (), left)
    earning = [rival for rival in causes if rival.fit is not None and rival.log_bayes_factor > least]
    first = _first(earning)
    if first and first.name != next(rival.name for rival in causes):
        causes = [rival for rival in causes if not _is_noise(rival) or rival == first]
    taken = None if first is None else first.cause
    return Step(tuple(rivals), taken, _credible(causes, taken), left)


def _first(earning: list[Rival]) -> Rival | None:
    """What to take of the causes that earn their place, best first.

    A mover that misses its targets passes for much that grows with the gradient: everything else is asked before it, and again beside it.
    Outliers spoil all other evidence: where they lead, and the mover does not explain them better, they come first.
    """
    structured = [rival for rival in earning if not _is_noise(rival)]
    leader = next(iter(earning), None)
    if leader is not None and _is_noise(leader) and structured and leader.name.startswith("position_jitter"):
        return structured[0]
    return leader


def _is_noise(rival: Rival) -> bool:
    return rival.cause is not None and isinstance(EFFECTS[rival.cause.name], NoiseEffect)


def screening(fit: Fit, pool: list[Candidate]) -> dict[Cause, tuple[float, Candidate]]:
    """Log evidence of every cause in the linear model, with its best start."""
    by_cause: dict[Cause, list[tuple[float, Candidate]]] = {}
    for candidate in pool:
        by_cause.setdefault(candidate.cause, []).append((linear_evidence(fit, candidate), candidate))
    result = {}
    for cause, starts in by_cause.items():
        values = torch.tensor([value for value, _ in starts], dtype=torch.float64)
        result[cause] = (log_mean_exp(values), starts[int(values.argmax())][1])
    return result


def linear_evidence(fit: Fit, candidate: Candidate) -> float:
    """Log Bayes factor of a candidate against nothing: half for all its quantities, half for some of them."""
    values = [_of_subset(fit, candidate, subset) for subset in candidate.subsets]
    if len(values) == 1:
        return values[0]
    parts = log_mean_exp(torch.tensor(values[:-1], dtype=torch.float64))
    return float(torch.logaddexp(torch.tensor(parts), torch.tensor(values[-1]))) - math.log(2.0)


def _of_subset(fit: Fit, candidate: Candidate, subset: tuple[int, ...]) -> float:
    gram = fit.projector.gram(candidate.columns, candidate.columns)
    score, started = _score(fit, candidate)
    pick = list(subset)
    return float(
        log_bayes_factor(gram[pick][:, pick], score[pick], candidate.prior_sd[pick], fit.free_noise, started)
    )


def _score(fit: Fit, candidate: Candidate) -> tuple[Tensor, float]:
    """Score of a candidate's columns at its start, and the gain in log density of the start itself."""
    score = candidate.columns.T @ fit.residual
    if not bool(candidate.shift.any()):
        return score, 0.0
    shift = candidate.shift[:, None]
    score = score - fit.projector.gram(candidate.columns, shift)[:, 0]
    gain = float(fit.residual @ candidate.shift - 0.5 * fit.projector.gram(shift, shift)[0, 0])
    return score, gain


def _in_full(fit: Fit, screened: float, start: Candidate) -> tuple[float, Fit]:
    """Evidence of a cause with everything fitted; what the screening said of parts of it is carried over."""
    observations = fit.observations
    rig = with_effect(fit.rig, start.cause, observations, start.shapes)
    full = fit_rig(rig, observations, fit.start_with(rig), fit.posterior.chain.rules)
    gain = full.log_evidence - fit.log_evidence
    if any(
        q.is_shape and not q.is_fixed
        for q in EFFECTS[start.cause.name].quantities(fit.posterior.chain.scene.extent)
    ):
        return max(gain, screened) if math.isfinite(gain) else screened, full
    linear = _of_subset(fit, start, start.subsets[-1])
    return screened + gain - linear, full


def _with_probabilities(rivals: list[Rival], n_causes: int) -> list[Rival]:
    """Most probable first."""
    log_prior = {"nothing": LOG_PRIOR_NOTHING, "unexplained": LOG_PRIOR_UNEXPLAINED}
    each = LOG_PRIOR_CAUSE - math.log(max(n_causes, 1))
    logs = torch.tensor(
        [r.log_bayes_factor + log_prior.get(r.name, each) for r in rivals], dtype=torch.float64
    )
    shares = torch.softmax(logs, 0).tolist()
    order = torch.argsort(logs, descending=True, stable=True).tolist()
    return [
        Rival(rivals[i].cause, rivals[i].name, rivals[i].log_bayes_factor, shares[i], rivals[i].fit)
        for i in order
    ]


def shares_of(causes: Sequence[Rival]) -> list[float]:
    """Probabilities of causes among each other, however small they are beside nothing and unexplained."""
    logs = torch.tensor([rival.log_bayes_factor for rival in causes], dtype=torch.float64)
    return list(torch.softmax(logs, 0).tolist())


def _credible(causes: list[Rival], taken: Cause | None) -> tuple[Rival, ...]:
    """The smallest set that holds 95 % of the probability of all causes, and the one that was taken in any case."""
    reached = torch.cumsum(torch.tensor(shares_of(causes), dtype=torch.float64), 0)
    n = int((reached < CREDIBLE).sum()) + 1
    return tuple(rival for i, rival in enumerate(causes) if i < n or rival.cause == taken)


def _without_idle(fit: Fit, base: Fit) -> tuple[Fit, list[Cause]]:
    """Drop causes, one after another, without which the evidence is higher; those far from their null are not refitted without."""
    gone: list[Cause] = []
    while True:
        own = [cause for cause in fit.rig.effects if cause not in base.rig.effects]
        doubtful = [cause for cause in own[:-1] if fit.log_evidence_for(cause) < SURELY_NEEDED]
        if not doubtful:
            return fit, gone
        observations, rules = fit.observations, fit.posterior.chain.rules
        without = [
            (cause, fit_rig(fit.rig.without_cause(cause), observations, fit.values, rules))
            for cause in doubtful
        ]
        cause, best = max(without, key=lambda pair: pair[1].log_evidence)
        if best.log_evidence <= fit.log_evidence:
            return fit, gone
        gone.append(cause)
        fit = best
