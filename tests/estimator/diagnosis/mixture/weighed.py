"""How probable each listed cause is alone, at all its starts, quantities and widths."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.hypotheses.candidates import candidates
from estimator.diagnosis.mixture.dictionary import dictionary
from estimator.diagnosis.mixture.evidence import Products
from estimator.diagnosis.mixture.expansion import Expansion
from estimator.diagnosis.mixture.items import Item
from estimator.diagnosis.mixture.listed import offered, starts_of
from estimator.rig.rig import Cause


def weighed(fit: Fit, causes: Sequence[Cause]) -> dict[Cause, tuple[float, Item]]:
    """Log posterior of the best item of each cause against nothing, up to a constant, and that item."""
    starts = starts_of(fit, candidates(fit, list(causes)))
    made = dictionary(Expansion.of(fit), offered(fit, starts), [])
    log_prior = torch.tensor([item.log_prior for item in made.items], dtype=torch.float64)
    values = (Products(made).beside([], 1.0) + log_prior).tolist()
    best: dict[Cause, tuple[float, Item]] = {}
    for value, item in zip(values, made.items, strict=True):
        if item.cause not in best or value > best[item.cause][0]:
            best[item.cause] = value, item
    return best
