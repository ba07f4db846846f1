"""The growth of a covariance that makes some numbers as uncertain as is wanted, and contradicts the readings least."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

MOST_SWEEPS = 1000
LEAST_GAIN = 1e-7  # of the cost, in a sweep over all numbers, for another one


def least_growth(covariance: Float[Tensor, "n n"], variance: Float[Tensor, " n"]) -> Float[Tensor, "n n"]:
    """The growth G of a covariance C with the smallest trace of C^-1 G for which no number has a smaller variance than wanted.

    That trace is what a draw of the growth costs on average in the sum of squares that C comes from. So numbers that readings tie together
    grow together, and one that they determine well grows only as far as it must.

    Args:
        covariance: Of the numbers.
        variance: The least that each should have.

    References: S. Burer and R. D. C. Monteiro, Mathematical Programming 95, 329 (2003), for semidefinite programmes by a factor of their
    matrix; here each column of the factor is set to its best in turn.

    Examples:
        >>> two = torch.tensor([[1.0, 0.9], [0.9, 1.0]], dtype=torch.float64)
        >>> least_growth(two, torch.tensor([4.0, 4.0], dtype=torch.float64)).round(decimals=3)
        tensor([[3., 3.],
                [3., 3.]], dtype=torch.float64)
    """
    sd = torch.sqrt(torch.diagonal(covariance))
    correlation = covariance / (sd[:, None] * sd)
    lacking = (variance / sd**2 - 1.0).clamp(min=0.0)
    factor = _grown_one_by_one(correlation, lacking)
    cost = torch.linalg.inv(correlation)
    last = float(((factor.T @ factor) * cost).sum())
    for _ in range(MOST_SWEEPS):
        for i in range(len(sd)):
            best = factor[:, i] - (factor @ cost[i]) / cost[i, i]
            length, least = best.norm(), lacking[i].sqrt()
            if length >= least:
                factor[:, i] = best
            elif length > 0.0:
                factor[:, i] = best * (least / length)
        now = float(((factor.T @ factor) * cost).sum())
        if last - now <= LEAST_GAIN * now:
            break
        last = now
    growth: Tensor = sd[:, None] * (factor.T @ factor) * sd
    return growth


def _grown_one_by_one(
    correlation: Float[Tensor, "n n"], lacking: Float[Tensor, " n"]
) -> Float[Tensor, "n n"]:
    """A factor F of a growth F^T F that is large enough: one number after another gets what it lacks, and all others follow it."""
    grown = correlation
    for i in torch.argsort(lacking, descending=True).tolist():
        along = grown[i] / grown[i, i]
        grown = grown + (lacking[i] + correlation[i, i] - grown[i, i]).clamp(min=0.0) * along[:, None] * along
    share, turn = torch.linalg.eigh(grown - correlation)
    factor: Tensor = (turn * share.clamp(min=0.0).sqrt()).T
    return factor
