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


def pairs(fit: Fit, pool: Sequence[Candidate]) -> list[tuple[float, Candidate, Candidate]]:
    """Log Bayes factor against nothing of every pair of causes, best first.

    Args:
        fit: Without them.
        pool: Columns of the causes, each start by itself. Starts away from the null are left out, for a linear model does not say where
            they would end beside another cause.
    """
    at_null = [candidate for candidate in pool if not bool(candidate.shift.any())]
    first, second = (index for index in torch.triu_indices(len(at_null), len(at_null), offset=1))
    differ = torch.tensor([at_null[i].cause != at_null[j].cause for i, j in zip(first, second, strict=True)])
    if not bool(differ.any()):
        return []
    first, second = first[differ], second[differ]
    width = max(len(candidate.keys) for candidate in at_null)
    columns = torch.zeros(len(fit.residual), len(at_null), width, dtype=torch.float64)
    prior_sd = torch.ones(len(at_null), width, dtype=torch.float64)
    for i, candidate in enumerate(at_null):
        columns[:, i, : len(candidate.keys)] = candidate.columns
        prior_sd[i, : len(candidate.keys)] = candidate.prior_sd
    flat = columns.flatten(1)
    gram = (
        fit.projector.gram(flat, flat).unflatten(0, (-1, width)).unflatten(2, (-1, width)).permute(0, 2, 1, 3)
    )
    score = (flat.T @ fit.residual).unflatten(0, (-1, width))
    joint_gram = torch.cat(
        (
            torch.cat((gram[first, first], gram[first, second]), dim=-1),
            torch.cat((gram[second, first], gram[second, second]), dim=-1),
        ),
        dim=-2,
    )
    evidence = log_bayes_factor(
        joint_gram,
        torch.cat((score[first], score[second]), dim=-1),
        torch.cat((prior_sd[first], prior_sd[second]), dim=-1),
        fit.free_noise,
    )
    order = torch.argsort(evidence, descending=True, stable=True).tolist()
    return [(float(evidence[k]), at_null[int(first[k])], at_null[int(second[k])]) for k in order]
