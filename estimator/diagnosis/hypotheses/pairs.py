"""Two causes that hide each other: neither explains much alone, both together do.

Where one cause cancels the other, the readings show little of either. All pairs are tested in the linear model, from one Gram matrix of
all projected columns.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch

from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.hypotheses.candidates import Candidate
from estimator.diagnosis.linear import log_bayes_factor

PAIRS_AT_ONCE = 2048


def pairs(fit: Fit, pool: Sequence[Candidate]) -> list[tuple[float, Candidate, Candidate]]:
    """Log Bayes factor against nothing of every pair of causes, best first.

    Args:
        fit: Without them.
        pool: Columns of the causes, each start by itself. Starts away from the null are left out, for a linear model does not say where
            they would end beside another cause.
    """
    at_null = [candidate for candidate in pool if not bool(candidate.shift.any())]
    causes = [candidate.cause for candidate in at_null]
    number = torch.tensor([causes.index(cause) for cause in causes])
    first, second = (index for index in torch.triu_indices(len(at_null), len(at_null), offset=1))
    differ = number[first] != number[second]
    if not bool(differ.any()):
        return []
    first, second = first[differ], second[differ]
    columns = torch.cat([candidate.columns for candidate in at_null], dim=1)
    prior_sd = torch.cat([candidate.prior_sd for candidate in at_null])
    gram, score = fit.projector.gram(columns, columns), columns.T @ fit.residual
    width = torch.tensor([len(candidate.keys) for candidate in at_null])
    begin = width.cumsum(0) - width
    evidence = torch.empty(len(first), dtype=torch.float64)
    # Pairs with as many columns are one batch, in parts that bound the memory.
    for widths in torch.unique(torch.stack((width[first], width[second]), dim=1), dim=0):
        alike = ((width[first] == widths[0]) & (width[second] == widths[1])).nonzero().flatten()
        for part in alike.split(PAIRS_AT_ONCE):
            of_first, of_second = (
                begin[which[part], None] + torch.arange(int(n))
                for which, n in zip((first, second), widths, strict=True)
            )
            both = torch.cat((of_first, of_second), dim=1)
            evidence[part] = log_bayes_factor(
                gram[both[:, :, None], both[:, None, :]], score[both], prior_sd[both], fit.free_noise
            )
    order = torch.argsort(evidence, descending=True, stable=True)
    ranked = zip(*(values[order].tolist() for values in (evidence, first, second)), strict=True)
    return [(value, at_null[i], at_null[j]) for value, i, j in ranked]
