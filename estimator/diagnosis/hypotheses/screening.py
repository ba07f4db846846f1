"""Inner products of the columns of many candidates, all that their evidence in the linear model depends on."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.hypotheses.candidates import Candidate
from estimator.diagnosis.linear import Products
from estimator.side_by_side import each

MOST_TOGETHER = 64  # candidates of one batch, which bounds the memory

# Numbers of candidates, and products of their columns and, last, shifts.
Batches = Sequence[tuple[list[int], Products]]


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
