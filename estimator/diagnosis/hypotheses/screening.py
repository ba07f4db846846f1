"""Log evidence of many causes: of all at once in the linear model, and of the leaders with everything fitted."""

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
    """Log evidence of every cause in the linear model, averaged over its starts and of the best of them, and that start."""
    by_cause: dict[Cause, list[tuple[float, Candidate]]] = {}
    for candidate in pool:
        by_cause.setdefault(candidate.cause, []).append((linear_evidence(fit, candidate), candidate))
    result = {}
    for cause, starts in by_cause.items():
        values = torch.tensor([value for value, _ in starts], dtype=torch.float64)
        result[cause] = (log_mean_exp(values), float(values.max()), starts[int(values.argmax())][1])
    return result


def linear_evidence(fit: Fit, candidate: Candidate) -> float:
    """Log Bayes factor of a candidate against nothing: half for all its quantities, half for some of them."""
    values = _by_subset(fit, candidate, candidate.subsets)
    if len(values) == 1:
        return values[0]
    parts = log_mean_exp(torch.tensor(values[:-1], dtype=torch.float64))
    return float(torch.logaddexp(torch.tensor(parts), torch.tensor(values[-1]))) - math.log(2.0)


def _by_subset(fit: Fit, candidate: Candidate, subsets: Sequence[tuple[int, ...]]) -> list[float]:
    """Log Bayes factor against nothing of some of a candidate's columns, for several choices of them, small ones first."""
    gram = fit.projector.gram(candidate.columns, candidate.columns)
    score, started = _score(fit, candidate)
    noise = fit.free_noise
    values: list[float] = []
    for _, of_one_size in groupby(sorted(subsets, key=len), key=len):
        pick = torch.tensor(list(of_one_size))
        some = gram[pick[:, :, None], pick[:, None, :]]
        values += log_bayes_factor(some, score[pick], candidate.prior_sd[pick], noise, started).tolist()
    return values


def _score(fit: Fit, candidate: Candidate) -> tuple[Tensor, float]:
    """Score of a candidate's columns at its start, and the gain in log density of the start itself."""
    score = candidate.columns.T @ fit.residual
    if not bool(candidate.shift.any()):
        return score, 0.0
    shift = candidate.shift[:, None]
    score = score - fit.projector.gram(candidate.columns, shift)[:, 0]
    gain = float(fit.residual @ candidate.shift - 0.5 * fit.projector.gram(shift, shift)[0, 0])
    return score, gain


def in_full(fit: Fit, screened: float, start: Candidate) -> tuple[float, Fit]:
    """Evidence of a cause with everything fitted; what the screening said of parts of it is carried over.

    Where the fit has left what the cause is, there is none for it.
    """
    observations = fit.observations
    rig = with_effect(fit.rig, start.cause, observations, start.shapes)
    full = fit_rig(
        rig, observations, fit.start_with(rig), fit.posterior.model.rules, tolerance=policy.ROUGH_TOLERANCE
    )
    gain = full.log_evidence - fit.log_evidence
    if not math.isfinite(gain):
        return screened, full
    if not full.still_has(start.cause):
        return 0.0, full
    quantities = EFFECTS[start.cause.name].quantities(fit.posterior.model.circumstances.extent)
    if any(q.is_shape and not q.is_fixed for q in quantities):
        # Laplace misses the width of shapes, and a linear model does not know their bounds.
        return min(max(gain, screened), gain + policy.SHAPES_WIDTH), full
    (linear,) = _by_subset(fit, start, start.subsets[-1:])
    return screened + gain - linear, full
