"""One effect at several places together: what is wrong with one sensor or coil may be wrong with others of its make.

Taken one after another, each would cost a step with all hypotheses, and other causes would stand in for those not yet taken.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from operator import itemgetter

import torch
from torch import Tensor

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.hypotheses.candidates import Candidate
from estimator.diagnosis.hypotheses.screening import products_of as screening_products
from estimator.diagnosis.hypotheses.screening import screening
from estimator.diagnosis.hypotheses.step import (
    Hypothesis,
    Step,
    credible_set,
    least_log_evidence,
    with_probabilities,
)
from estimator.diagnosis.linear import Projector, log_bayes_factor
from estimator.diagnosis.structure.discrepancy import discrepancy
from estimator.diagnosis.structure.discrepancy import products_of as curve_products
from estimator.diagnosis.structure.families.collection import Family
from estimator.effects import EFFECTS
from estimator.effects.attach import with_effect
from estimator.rig.rig import Cause, Rig
from estimator.side_by_side import each


def at_several_places(fit: Fit, pool: Sequence[Candidate]) -> Fit | None:
    """The fit with one effect at two or more new places; None where a cause at one place does better.

    The effect is that with the highest evidence in the linear model, over the best set of its places. After the fit, the evidence for each
    place beside the others must suffice as if it had been tested alone; the other places are left to later steps. What sets in at an
    instant is an event, and happens at one place.

    Args:
        fit: With the causes taken so far.
        pool: Columns of every cause at the fit.
    """
    absent = [candidate for candidate in pool if candidate.cause not in fit.rig.effects]
    n_places = Counter(cause.name for cause in {candidate.cause for candidate in absent})
    if max(n_places.values(), default=0) < 2:
        return None
    screened = screening(fit, absent)
    best_alone = max(row.highest for row in screened.values())
    least = max(best_alone, 0.0) + least_log_evidence(len(screened))
    starts_by_name = [
        [row.start for cause, row in screened.items() if cause.name == name]
        for name, n in n_places.items()
        if n > 1 and not _is_event(name, fit)
    ]
    if not starts_by_name:
        return None
    evidence, best_starts = max((joint_evidence(fit, starts) for starts in starts_by_name), key=itemgetter(0))
    if evidence <= least:
        return None
    wider = with_several(fit, best_starts, least_log_evidence(len(screened)))
    is_better = wider is not None and wider.log_evidence - fit.log_evidence > least
    return wider if is_better else None


def with_several(fit: Fit, starts: Sequence[Candidate], least: float) -> Fit | None:
    """The fit with those of several causes whose evidence suffices beside the others; None where fewer than two are left.

    Args:
        fit: Without them.
        starts: Where each begins.
        least: Log evidence that each needs.
    """
    rig = fit.rig
    for start in starts:
        rig = with_effect(rig, start.cause, fit.observations, start.shapes)
    wider = fit_with_needed(fit, rig, [start.cause for start in starts], least)
    return wider if len(wider.rig.effects) > len(fit.rig.effects) + 1 else None


def _is_event(name: str, fit: Fit) -> bool:
    """Whether an effect sets in at an instant, or has another shape that no fit moves."""
    extent = fit.posterior.model.circumstances.extent
    return any(quantity.is_fixed for quantity in EFFECTS[name].quantities(extent))


def joint_evidence(
    fit: Fit, starts: Sequence[Candidate], least: float = 0.0
) -> tuple[float, list[Candidate]]:
    """Log Bayes factor of several causes together in the linear model, and the causes, less those that are not needed (removed one by one).

    -inf where one starts away from its null, for there the linear model does not hold.

    Args:
        fit: Without them.
        starts: One of each cause.
        least: Log evidence that each needs beside the others.
    """
    if not all(start.is_at_null for start in starts):
        return -math.inf, []
    columns = torch.cat([start.columns for start in starts], dim=1)
    prior_sd = torch.cat([start.prior_sd for start in starts])
    gram, score = fit.projector.gram(columns, columns), columns.T @ fit.residual
    start_of_column = [i for i, start in enumerate(starts) for _ in start.keys]

    def evidence(members: frozenset[int]) -> float:
        columns = [i for i, start in enumerate(start_of_column) if start in members]
        return float(
            log_bayes_factor(gram[columns][:, columns], score[columns], prior_sd[columns], fit.free_noise)
        )

    members = frozenset(range(len(starts)))
    best = evidence(members)
    while len(members) > 1:
        value, fewer = max(((evidence(members - {i}), members - {i}) for i in members), key=itemgetter(0))
        if value <= best - least:
            break
        best, members = value, fewer
    return best, [starts[i] for i in sorted(members)]


def fit_with_needed(
    fit: Fit,
    rig: Rig,
    causes: Sequence[Cause],
    least: float,
    start: Mapping[str, Tensor | float] | None = None,
    to_beat: float = -math.inf,
    tolerance: float = policy.ROUGH_TOLERANCE,
) -> Fit:
    """The fit with those of several causes whose evidence suffices beside the others.

    Args:
        fit: One near by: mostly that without them.
        rig: With all of them.
        causes: Those that are asked.
        least: Log evidence that each needs.
        start: Values by parameter to start from; those of the fit near by, and nominal ones, by default.
        to_beat: Log posterior density of another fit with all of them: where this one is lower it ends early, and is the fit near by.
        tolerance: Rise in log density below which fits stop.
    Returns: The fit near by where none of them suffices.
    """
    rules, start = fit.posterior.model.rules, start or fit.start_with(rig)
    wider = fit_rig(
        rig,
        fit.observations,
        start,
        rules,
        tolerance=tolerance,
        near=fit,
        to_beat=to_beat,
    )
    if float(wider.optimum.log_posterior) < to_beat:
        return fit
    while idle := [cause for cause in causes if wider.log_evidence_for(cause) <= least]:
        rig = wider.rig
        for cause in idle:
            rig = rig.without_cause(cause)
        causes = [cause for cause in causes if cause not in idle]
        if not causes:
            return fit
        wider = fit_rig(rig, fit.observations, wider.values, rules, tolerance=tolerance, near=wider)
    return wider


def without_idle(fit: Fit, base: Fit, needed: set[Cause] | None = None) -> tuple[Fit, list[Cause]]:
    """Drop causes, the least needed first, while the evidence rises; do not try it for causes far from their null.

    Args:
        fit: With all causes.
        base: With those that stay.
        needed: Causes that a fit has shown to be needed, where they are not tried again; the next one is put there.
    """
    dropped: list[Cause] = []
    while True:
        added = [cause for cause in fit.rig.effects if cause not in base.rig.effects]
        evidence = {cause: fit.log_evidence_for(cause) for cause in added[:-1]}
        cause = min(evidence, key=evidence.__getitem__, default=None)
        if cause is None or evidence[cause] > policy.SURELY_NEEDED or (needed and cause in needed):
            return fit, dropped
        rig, rules = fit.rig.without_cause(cause), fit.posterior.model.rules
        best = fit_rig(rig, fit.observations, fit.values, rules, tolerance=policy.ROUGH_TOLERANCE, near=fit)
        if best.log_evidence <= fit.log_evidence:
            if needed is not None:
                needed.add(cause)
            return fit, dropped
        dropped.append(cause)
        fit = best


def comparison_steps(
    fit: Fit, causes: Sequence[Cause], pool: Sequence[Candidate], smooth: Sequence[Family]
) -> list[Step]:
    """Compare each of some causes of a fit, in the linear model, with every other hypothesis in its place.

    A hypothesis may also explain what remains beside the cause. Its log Bayes factor without the cause is therefore reduced by that beside
    the cause.

    Args:
        fit: With the causes.
        causes: Those that were taken together.
        pool, smooth: Columns of every cause and families of flexible curves at the fit.
    """
    asked = [c for c in pool if c.cause in causes or c.cause not in fit.rig.effects]
    of_causes, of_curves = screening_products(fit, asked), curve_products(fit, smooth)
    beside = {
        cause: max(row.log_bayes_factor, 0.0)
        for cause, row in screening(fit, asked, of_causes).items()
        if cause not in causes
    }
    curve_beside = max(discrepancy(fit, smooth, of_curves).log_bayes_factor, 0.0)

    def compared(cause: Cause) -> Step:
        without, others, shift, growth = _without(fit, cause)
        smaller = [(some, p.without(others, shift, growth, are_whitened=True)) for some, p in of_causes]
        screened = screening(without, asked, smaller)
        screened = {rival: row for rival, row in screened.items() if rival == cause or rival in beside}
        smaller = [(some, p.without(others, shift, growth, are_whitened=False)) for some, p in of_curves]
        curve = discrepancy(without, smooth, smaller)
        hypotheses = [
            Hypothesis(None, "nothing", 0.0),
            Hypothesis(None, "unexplained", curve.log_bayes_factor - curve_beside),
            *(
                Hypothesis(
                    rival, rival.label, value - beside.get(rival, 0.0), fit=fit if rival == cause else None
                )
                for rival, (value, _, _) in screened.items()
            ),
        ]
        ranked = with_probabilities(hypotheses, len(screened))
        ranked_causes = [hypothesis for hypothesis in ranked if hypothesis.cause is not None]
        return Step(tuple(ranked), cause, credible_set(ranked_causes, cause), curve)

    return list(each(compared, causes))


def _without(fit: Fit, cause: Cause) -> tuple[Fit, list[int], Tensor, float]:
    """The fit without one of its causes, to first order: the coordinates that it has, how all move, and by what its noise would grow."""
    coordinates = fit.posterior.coordinates
    of_cause, null = fit.at_null(cause)
    others = [i for i, name in enumerate(coordinates.names) if not name.startswith(f"{cause.label}.")]
    covariance = fit.covariance[of_cause][:, of_cause]
    shift = fit.covariance[:, of_cause] @ torch.linalg.solve(covariance, null - fit.vector[of_cause])
    residual = fit.residual - fit.jacobian @ shift
    growth = 1.0 if fit.free_noise is None else max(float(residual.norm() / fit.residual.norm()), 1.0)
    jacobian = fit.jacobian[:, others] / growth
    prior = (fit.optimum.precision - fit.optimum.information)[0][others][:, others]
    return fit.to_first_order(Projector.of(jacobian, prior), residual / growth), others, shift, growth
