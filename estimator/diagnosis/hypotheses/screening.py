"""Log evidence of many causes: of all in the linear model, and of the leaders by a full fit."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.hypotheses.candidates import Candidate
from estimator.diagnosis.linear import FreeNoise, Products, Projector, log_bayes_factor, log_mean_exp
from estimator.effects import EFFECTS
from estimator.effects.attach import with_effect
from estimator.rig.rig import Cause
from estimator.side_by_side import each

MOST_TOGETHER = 64  # candidates of one batch, which bounds the memory


# Numbers of candidates, and products of their columns and, last, shifts.
Batches = Sequence[tuple[list[int], Products]]


class Screened(NamedTuple):
    """What the linear model says of a cause.

    Attributes:
        log_bayes_factor: Against nothing, averaged over its starts.
        highest: That of its best start.
        start: This start.
    """

    log_bayes_factor: float
    highest: float
    start: Candidate


def screening(fit: Fit, pool: Sequence[Candidate], batches: Batches | None = None) -> dict[Cause, Screened]:
    """Evidence for every cause in the linear model."""
    by_cause: dict[Cause, list[tuple[float, Candidate]]] = {}
    for candidate, value in zip(pool, linear_evidence(fit, pool, batches), strict=True):
        by_cause.setdefault(candidate.cause, []).append((value, candidate))
    result = {}
    for cause, starts in by_cause.items():
        values = torch.tensor([value for value, _ in starts], dtype=torch.float64)
        result[cause] = Screened(log_mean_exp(values), float(values.max()), starts[int(values.argmax())][1])
    return result


def products_of(fit: Fit, pool: Sequence[Candidate]) -> Batches:
    """Products of candidates at a fit. Those with the same quantities are taken together, some at a time."""
    alike: dict[tuple[str, ...], list[int]] = {}
    for i, candidate in enumerate(pool):
        alike.setdefault(candidate.keys, []).append(i)
    batches = [
        members[first : first + MOST_TOGETHER]
        for members in alike.values()
        for first in range(0, len(members), MOST_TOGETHER)
    ]
    projector, residual = fit.projector, fit.residual

    def products(some: list[int]) -> tuple[list[int], Products]:
        columns = torch.stack([torch.cat((pool[i].columns.T, pool[i].shift[None])) for i in some])
        return some, Products.of(columns, projector, residual)

    return list(each(products, batches))


def linear_evidence(fit: Fit, pool: Sequence[Candidate], batches: Batches | None = None) -> list[float]:
    """Log Bayes factor of each candidate against nothing.

    Half of its prior is for all its quantities together, half for some of them.

    Args:
        fit: Whose residual is asked.
        pool: The candidates.
        batches: Their products at the fit, where they are known.
    """
    result = [0.0] * len(pool)
    batches = products_of(fit, pool) if batches is None else batches
    projector, noise = fit.projector, fit.free_noise

    def evidence(batch: tuple[list[int], Products]) -> Tensor:
        some, products = batch
        values = _by_subset([pool[i] for i in some], pool[some[0]].subsets, products, projector, noise)
        if values.shape[1] == 1:
            return values[:, 0]
        of_some = torch.logsumexp(values[:, :-1], 1) - math.log(values.shape[1] - 1)
        return torch.logaddexp(of_some, values[:, -1]) - math.log(2.0)

    for (some, _), values in zip(batches, each(evidence, batches), strict=True):
        for i, value in zip(some, values.tolist(), strict=True):
            result[i] = value
    return result


def _by_subset(
    candidates: Sequence[Candidate],
    subsets: Sequence[tuple[int, ...]],
    products: Products,
    projector: Projector,
    noise: FreeNoise | None,
) -> Float[Tensor, "candidate subset"]:
    """Log Bayes factor against nothing of each subset of the columns of several candidates, by size, smallest first."""
    prior_sd = torch.stack([candidate.prior_sd for candidate in candidates])
    gram = products.gram(projector)
    # At a start away from the null its shift has changed the residual.
    score = products.score[:, :-1] - gram[:, :-1, -1]
    started = products.score[:, -1] - 0.5 * gram[:, -1, -1]
    gram = gram[:, :-1, :-1]
    values, ordered = [], sorted(subsets, key=len)
    for _, of_one_size in groupby(ordered, key=len):
        chosen = torch.tensor(list(of_one_size), device=gram.device)
        values.append(
            log_bayes_factor(
                gram[:, chosen[:, :, None], chosen[:, None, :]],
                score[:, chosen],
                prior_sd[:, chosen],
                noise,
                started[:, None],
            )
        )
    evidence = torch.cat(values, dim=1)
    for i in candidates[0].one_sided:
        # What cannot be negative explains nothing where it would have to be.
        alone = [k for k, subset in enumerate(ordered) if subset == (i,)]
        most = torch.where(score[:, i] < 0.0, 0.0, torch.inf)
        evidence[:, alone] = evidence[:, alone].minimum(most[:, None])
    return evidence


Reached = Mapping[Cause, Mapping[str, Tensor]]  # by cause: what its own parameters were in its last fit


def in_full(fit: Fit, screened: float, start: Candidate, reached: Reached | None = None) -> tuple[float, Fit]:
    """Log Bayes factor of a cause by a full fit, corrected by the screening for subsets of its quantities.

    It is 0 where the cause is no longer itself at the fitted values.

    Args:
        fit: Without it.
        screened: Log Bayes factor in the linear model.
        start: Where the linear model has it.
        reached: Where an earlier comparison has found it, which the fit starts from where the density is higher there.
    """
    observations = fit.observations
    circumstances = fit.posterior.model.circumstances
    rig = with_effect(fit.rig, start.cause, observations, start.shapes, circumstances=circumstances)
    full = fit_rig(
        rig,
        observations,
        fit.start_with(rig),
        fit.posterior.model.rules,
        tolerance=policy.ROUGH_TOLERANCE,
        near=fit,
        other_start=(reached or {}).get(start.cause),
    )
    value = full.log_evidence - fit.log_evidence
    if not math.isfinite(value):
        return screened, full
    if not full.still_has(start.cause):
        return 0.0, full
    quantities = EFFECTS[start.cause.name].quantities(circumstances.extent)
    if any(q.is_shape and not q.is_fixed for q in quantities):
        # The Laplace evidence misses the width of shapes, and the linear model their bounds.
        return min(max(value, screened), value + policy.SHAPES_WIDTH), full
    ((_, products),) = products_of(fit, [start])
    linear_value = float(_by_subset([start], start.subsets[-1:], products, fit.projector, fit.free_noise))
    return screened + value - linear_value, full
