"""Two causes that hide each other: neither explains much alone, both together do.

Where one cause cancels the other, the readings show little of either. All pairs are tested in the linear model, from one Gram matrix of
all projected columns. A bound on their evidence, which costs one small factorisation, leaves out most of them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from jaxtyping import Int
from torch import Tensor

from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.hypotheses.candidates import Candidate
from estimator.diagnosis.linear import highest_log_bayes_factor, log_bayes_factor

PAIRS_AT_ONCE = 2048


def pairs(
    fit: Fit, pool: Sequence[Candidate], least: float = -math.inf
) -> list[tuple[float, Candidate, Candidate]]:
    """Log Bayes factor against nothing of every pair of causes, best first.

    Args:
        fit: Without them.
        pool: Columns of the causes, each start by itself. Starts away from the null are left out, for a linear model does not say where
            they would end beside another cause.
        least: Pairs whose log Bayes factor cannot exceed it are left out.
    """
    at_null = [candidate for candidate in pool if candidate.is_at_null]
    number_of = {cause: i for i, cause in enumerate(dict.fromkeys(c.cause for c in at_null))}
    device = fit.residual.device
    number = torch.tensor([number_of[candidate.cause] for candidate in at_null], device=device)
    first, second = torch.triu_indices(len(at_null), len(at_null), offset=1, device=device)
    differ = number[first] != number[second]
    if not bool(differ.any()):
        return []
    first, second = first[differ], second[differ]
    columns = torch.cat([candidate.columns for candidate in at_null], dim=1)
    prior_sd = torch.cat([candidate.prior_sd for candidate in at_null])
    gram, score = fit.projector.own_gram(columns), columns.T @ fit.residual
    gram, score = gram * prior_sd[:, None] * prior_sd, score * prior_sd
    width = torch.tensor([len(candidate.keys) for candidate in at_null], device=device)
    begin = width.cumsum(0) - width
    noise = fit.free_noise
    evidence = score.new_full((len(first),), -math.inf)
    # Pairs with as many columns are one batch, in parts that bound the memory.
    widths_code = width[first] * (int(width.max()) + 1) + width[second]
    by_widths = torch.argsort(widths_code, stable=True)
    for alike in by_widths.split([n for n in torch.bincount(widths_code).tolist() if n]):
        widths = (int(width[first[alike[0]]]), int(width[second[alike[0]]]))
        for part in alike.split(PAIRS_AT_ONCE):
            both = _columns_of(begin, first[part], second[part], widths)
            grams, scores, alive = gram[both[:, :, None], both[:, None, :]], score[both], part
            if math.isfinite(least):
                is_alive = highest_log_bayes_factor(grams, scores, noise) > least
                grams, scores, alive = grams[is_alive], scores[is_alive], part[is_alive]
            if len(alive):
                evidence[alive] = log_bayes_factor(grams, scores, torch.ones_like(scores), noise)
    asked = (evidence > least).nonzero().flatten()
    ranked = asked[torch.argsort(evidence[asked], descending=True, stable=True)]
    rows = zip(*(values[ranked].tolist() for values in (evidence, first, second)), strict=True)
    return [(value, at_null[i], at_null[j]) for value, i, j in rows]


def _columns_of(
    begin: Int[Tensor, " candidate"],
    first: Int[Tensor, " pair"],
    second: Int[Tensor, " pair"],
    widths: tuple[int, int],
) -> Int[Tensor, "pair column"]:
    """Numbers of the columns of each pair, of as many of the first and of the second cause as the widths say."""
    return torch.cat(
        [
            begin[which, None] + torch.arange(n, device=begin.device)
            for which, n in zip((first, second), widths, strict=True)
        ],
        dim=1,
    )
