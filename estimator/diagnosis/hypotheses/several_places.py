"""One kind of cause at several places at once: what one sensor or coil has wrong, others of its make may have too.

One after another they would take a step each, with all hypotheses, and until the last of them is there something else stands in for it.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from operator import itemgetter

import torch

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.hypotheses.candidates import Candidate
from estimator.diagnosis.hypotheses.screening import screening
from estimator.diagnosis.hypotheses.step import (
    Hypothesis,
    Step,
    credible_set,
    least_log_evidence,
    with_probabilities,
)
from estimator.diagnosis.linear import Projector, log_bayes_factor
from estimator.diagnosis.structure.discrepancy import Family, discrepancy
from estimator.effects import EFFECTS
from estimator.effects.attach import with_effect
from estimator.rig.rig import Cause


def at_several_places(fit: Fit, pool: Sequence[Candidate]) -> Fit | None:
    """A fit with a cause at two places or more, where that explains more than any cause at one; None where none does.

    The kind is that with the highest evidence, in the linear model, for its places together, those left out that only cost. After the
    fit each place has to earn its cause beside the others, by as much as if it had been asked alone; the others stay in the race.

    Args:
        fit: With the causes that were taken so far.
        pool: Columns of every cause at the fit.
    """
    absent = [c for c in pool if c.cause not in fit.rig.effects]
    count = Counter(cause.name for cause in {c.cause for c in absent})
    if max(count.values(), default=0) < policy.FEWEST_PLACES:
        return None
    screened = screening(fit, absent)
    alone = max(highest for _, highest, _ in screened.values())
    least = max(alone, 0.0) + least_log_evidence(len(screened))
    kinds = [
        [start for cause, (_, _, start) in screened.items() if cause.name == name]
        for name, n in count.items()
        if n >= policy.FEWEST_PLACES
    ]
    value, kind = max((together(fit, starts) for starts in kinds), key=itemgetter(0))
    if value <= least:
        return None
    wider = _kept(fit, kind, least_log_evidence(len(screened)))
    n_more = len(wider.rig.effects) - len(fit.rig.effects)
    is_more = wider.log_evidence - fit.log_evidence > least
    return wider if n_more >= policy.FEWEST_PLACES and is_more else None


def together(fit: Fit, starts: Sequence[Candidate]) -> tuple[float, list[Candidate]]:
    """Log evidence in the linear model of several causes at once, and of which: one after another goes that costs more than it explains.

    Where one starts away from its null that model does not hold.
    """
    if any(bool(start.shift.any()) for start in starts):
        return -math.inf, []
    columns = torch.cat([start.columns for start in starts], dim=1)
    prior_sd = torch.cat([start.prior_sd for start in starts])
    gram, score = fit.projector.gram(columns, columns), columns.T @ fit.residual
    owner = torch.repeat_interleave(torch.tensor([start.columns.shape[1] for start in starts]))

    def evidence(members: frozenset[int]) -> float:
        pick = torch.isin(owner, torch.tensor(sorted(members)))
        return float(log_bayes_factor(gram[pick][:, pick], score[pick], prior_sd[pick], fit.free_noise))

    members = frozenset(range(len(starts)))
    best = evidence(members)
    while len(members) > 1:
        value, fewer = max(((evidence(members - {i}), members - {i}) for i in members), key=itemgetter(0))
        if value <= best:
            break
        best, members = value, fewer
    return best, [starts[i] for i in sorted(members)]


def _kept(fit: Fit, starts: Sequence[Candidate], least: float) -> Fit:
    """The fit with those of several causes that earn their places beside each other."""
    rig, rules = fit.rig, fit.posterior.model.rules
    for start in starts:
        rig = with_effect(rig, start.cause, fit.observations, start.shapes)
    asked = [start.cause for start in starts]
    wider = fit_rig(rig, fit.observations, fit.start_with(rig), rules, tolerance=policy.ROUGH_TOLERANCE)
    while idle := [cause for cause in asked if wider.log_evidence_for(cause) <= least]:
        rig = wider.rig
        for cause in idle:
            rig = rig.without_cause(cause)
        asked = [cause for cause in asked if cause not in idle]
        if not asked:
            return fit
        wider = fit_rig(rig, fit.observations, wider.values, rules, tolerance=policy.ROUGH_TOLERANCE)
    return wider


def comparison_steps(
    fit: Fit, causes: Sequence[Cause], pool: Sequence[Candidate], smooth: Sequence[Family]
) -> list[Step]:
    """How each of some causes of a fit compares, in the linear model, with every other hypothesis in its place.

    Much may be left beside them that others explain as well: of a hypothesis counts what it loses where the cause is there.

    Args:
        fit: With the causes.
        causes: Those that were taken together.
        pool, smooth: Columns of every cause and families of flexible curves at the fit.
    """
    absent = [c for c in pool if c.cause not in fit.rig.effects]
    beside = {cause: max(value, 0.0) for cause, (value, _, _) in screening(fit, absent).items()}
    left = max(discrepancy(fit, list(smooth)).log_bayes_factor, 0.0)
    steps = []
    for cause in causes:
        without, growth = _without(fit, cause)
        lighter = torch.full_like(fit.residual, 1.0 / growth)
        asked = [c.weighed(lighter) for c in pool if c.cause == cause or c.cause in beside]
        screened = screening(without, asked)
        curve = discrepancy(without, [family.weighed(lighter) for family in smooth])
        hypotheses = [
            Hypothesis(None, "nothing", 0.0),
            Hypothesis(None, "unexplained", curve.log_bayes_factor - left),
            *(
                Hypothesis(
                    other, other.label, value - beside.get(other, 0.0), fit=fit if other == cause else None
                )
                for other, (value, _, _) in screened.items()
            ),
        ]
        ranked = with_probabilities(hypotheses, len(screened))
        named = [hypothesis for hypothesis in ranked if hypothesis.cause is not None]
        steps.append(Step(tuple(ranked), cause, credible_set(named, cause), curve))
    return steps


def _without(fit: Fit, cause: Cause) -> tuple[Fit, float]:
    """The fit as it would be without one of its causes, to first order, and by how much its noise would be larger."""
    coordinates = fit.posterior.coordinates
    nulls = {
        f"{cause.label}.{q.key}": q.null
        for q in EFFECTS[cause.name].quantities(fit.posterior.model.circumstances.extent)
        if not q.is_shape
    }
    own = [i for i, name in enumerate(coordinates.names) if name in nulls]
    rest = [i for i, name in enumerate(coordinates.names) if not name.startswith(f"{cause.label}.")]
    null = torch.tensor([nulls[coordinates.names[i]] for i in own], dtype=torch.float64)
    moved = fit.covariance[:, own] @ torch.linalg.solve(fit.covariance[own][:, own], null - fit.vector[own])
    residual = fit.residual - fit.jacobian @ moved
    growth = 1.0 if fit.free_noise is None else max(float(residual.norm() / fit.residual.norm()), 1.0)
    jacobian = fit.jacobian[:, rest] / growth
    prior = (fit.optimum.precision - fit.optimum.information)[0][rest][:, rest]
    return fit.to_first_order(Projector.of(jacobian, prior), residual / growth), growth
