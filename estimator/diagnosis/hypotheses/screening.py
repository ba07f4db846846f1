"""Log evidence of many causes: of all in the linear model, and of the leaders by a full fit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import groupby

import torch
from torch import Tensor

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.hypotheses.candidates import Candidate
from estimator.diagnosis.linear import log_bayes_factor, log_mean_exp
from estimator.effects import EFFECTS
from estimator.effects.attach import with_effect
from estimator.rig.rig import Cause


def screening(fit: Fit, pool: Sequence[Candidate]) -> dict[Cause, tuple[float, float, Candidate]]:
    """For every cause in the linear model: log Bayes factor averaged over its starts, that of its best start, and that start."""
    by_cause: dict[Cause, list[tuple[float, Candidate]]] = {}
    for candidate in pool:
        by_cause.setdefault(candidate.cause, []).append((linear_evidence(fit, candidate), candidate))
    result = {}
    for cause, starts in by_cause.items():
        values = torch.tensor([value for value, _ in starts], dtype=torch.float64)
        result[cause] = (log_mean_exp(values), float(values.max()), starts[int(values.argmax())][1])
    return result


def linear_evidence(fit: Fit, candidate: Candidate) -> float:
    """Log Bayes factor of a candidate against nothing; half of the prior is for all its quantities together, half for some of them."""
    values = _by_subset(fit, candidate, candidate.subsets)
    if len(values) == 1:
        return values[0]
    of_some = log_mean_exp(torch.tensor(values[:-1], dtype=torch.float64))
    return float(torch.logaddexp(torch.tensor(of_some), torch.tensor(values[-1]))) - math.log(2.0)


def _by_subset(fit: Fit, candidate: Candidate, subsets: Sequence[tuple[int, ...]]) -> list[float]:
    """Log Bayes factor against nothing of each subset of a candidate's columns, by size, smallest first."""
    gram = fit.projector.gram(candidate.columns, candidate.columns)
    score, start_log_density = _score(fit, candidate)
    noise = fit.free_noise
    values: list[float] = []
    for _, of_one_size in groupby(sorted(subsets, key=len), key=len):
        columns = torch.tensor(list(of_one_size))
        values += log_bayes_factor(
            gram[columns[:, :, None], columns[:, None, :]],
            score[columns],
            candidate.prior_sd[columns],
            noise,
            start_log_density,
        ).tolist()
    return values


def _score(fit: Fit, candidate: Candidate) -> tuple[Tensor, float]:
    """Score of a candidate's columns at its start, and the rise in log density at the start itself."""
    score = candidate.columns.T @ fit.residual
    if not bool(candidate.shift.any()):
        return score, 0.0
    shift = candidate.shift[:, None]
    score = score - fit.projector.gram(candidate.columns, shift)[:, 0]
    start_log_density = float(fit.residual @ candidate.shift - 0.5 * fit.projector.gram(shift, shift)[0, 0])
    return score, start_log_density


def in_full(fit: Fit, screened: float, start: Candidate) -> tuple[float, Fit]:
    """Log Bayes factor of a cause by a full fit, corrected by the screening for subsets of its quantities.

    It is 0 where the cause is no longer itself at the fitted values.
    """
    observations = fit.observations
    rig = with_effect(fit.rig, start.cause, observations, start.shapes)
    full = fit_rig(
        rig, observations, fit.start_with(rig), fit.posterior.model.rules, tolerance=policy.ROUGH_TOLERANCE
    )
    value = full.log_evidence - fit.log_evidence
    if not math.isfinite(value):
        return screened, full
    if not full.still_has(start.cause):
        return 0.0, full
    quantities = EFFECTS[start.cause.name].quantities(fit.posterior.model.circumstances.extent)
    if any(q.is_shape and not q.is_fixed for q in quantities):
        # The Laplace evidence misses the width of shapes, and the linear model their bounds.
        return min(max(value, screened), value + policy.SHAPES_WIDTH), full
    (linear_value,) = _by_subset(fit, start, start.subsets[-1:])
    return screened + value - linear_value, full
