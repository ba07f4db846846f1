"""Small dictionaries of made-up columns, of which everything is known."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from estimator.diagnosis.linear import Projector
from estimator.diagnosis.mixture.items import Dictionary, Item
from estimator.diagnosis.mixture.links import Link
from estimator.rig.rig import Cause

N, N_NUMBERS = 40, 3


def item(
    name: str,
    columns: Sequence[int],
    width: float = 2.0,
    log_prior: float = -2.0,
    shift: int | None = None,
    is_listed: bool = True,
    is_one_sided: bool = False,
) -> Item:
    """An item of the hall sensor."""
    widths = tuple(width * (1.0 + 0.5 * k) for k in range(len(columns)))
    keys = tuple(f"key{k}" for k in columns)
    cause = Cause(name, "hall")
    return Item(
        cause, is_listed, Link.RESPONSE, {}, keys, tuple(columns), widths, shift, log_prior, is_one_sided
    )


def dictionary(
    items: Sequence[Item], residual: Tensor | None = None, prior_precision: float = 0.3
) -> Dictionary:
    """Items with columns, and numbers that are always there, drawn once."""
    generator = torch.Generator().manual_seed(7)

    def drawn(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator, dtype=torch.float64)

    columns, jacobian, noise = 0.3 * drawn(N, 16), drawn(N, N_NUMBERS), drawn(N)
    precision = prior_precision * torch.eye(N_NUMBERS, dtype=torch.float64)
    always = Projector.of(jacobian, precision)
    return Dictionary(tuple(items), columns, noise if residual is None else residual, always, precision)


def log_density(made: Dictionary, chosen: Sequence[int], noise: float = 1.0) -> float:
    """Log density of the residual with some items, by its covariance matrix, number by number."""
    jacobian = made.always.jacobian
    covariance = noise**2 * torch.eye(N, dtype=torch.float64)
    covariance += jacobian @ torch.linalg.inv(made.prior_precision) @ jacobian.T
    mean = torch.zeros(N, dtype=torch.float64)
    for i in chosen:
        one = made.items[i]
        own = made.columns[:, list(one.columns)] * torch.tensor(one.widths, dtype=torch.float64)
        covariance += own @ own.T
        if one.shift is not None:
            mean += made.columns[:, one.shift]
    return float(torch.distributions.MultivariateNormal(mean, covariance).log_prob(made.residual))
