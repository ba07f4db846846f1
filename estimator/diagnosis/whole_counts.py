"""Loop counts are whole numbers also where a covariance was widened: a normal law, given that they are."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.inference.lattice import MOST_EFFECTIVE
from estimator.rig.coordinates import Coordinates


def with_whole_counts(
    coordinates: Coordinates,
    draws: Float[Tensor, "draw coordinate"],
    centre: Float[Tensor, " coordinate"],
    generator: torch.Generator,
) -> dict[str, Tensor]:
    """Draws of a normal law, each carried to whole loop counts as the law itself goes along with them.

    Each set of counts has the probability that the law gives it. Where more sets are plausible than a table holds, counts stay real, which
    describes them as well.

    Args:
        coordinates: With real counts.
        draws: From the law, but perhaps about another middle.
        centre: Middle of the law.
        generator: Draws the counts.
    Returns: Every number of the rig, draw by draw.
    References: Doucet, A note on efficient conditional simulation of Gaussian distributions (2010): a draw is carried by its regression.
    """
    values = coordinates.values(draws)
    counted = [parameter for parameter in coordinates.parameters if parameter.is_count]
    names = [parameter.name for parameter in counted]
    if not names:
        return values
    real = torch.stack([values[name] for name in names], dim=1)
    tuples, n_draws = torch.unique(real.round().clamp(min=1.0), dim=0, return_counts=True)
    share = n_draws / n_draws.sum()
    if float(torch.exp(-(share * torch.log(share)).sum())) > MOST_EFFECTIVE:
        return values
    logarithm = torch.log(real)
    covariance = logarithm.T.cov(correction=0).reshape(len(names), len(names))
    about = coordinates.values(centre)
    away = torch.log(tuples) - torch.log(torch.stack([about[name] for name in names]))
    log_weight = -0.5 * (away * torch.linalg.solve(covariance, away.T).T).sum(1) - torch.log(tuples).sum(1)
    for column, parameter in enumerate(counted):
        assert parameter.prior is not None
        is_allowed = (tuples[:, column] >= parameter.prior.lower) & (
            tuples[:, column] <= parameter.prior.upper
        )
        log_weight = torch.where(is_allowed, log_weight, -torch.inf)
    if not bool(torch.isfinite(log_weight).any()):
        return values
    row = torch.multinomial(torch.softmax(log_weight, 0), len(draws), replacement=True, generator=generator)
    together = (draws - draws.mean(0)).T @ (logarithm - logarithm.mean(0)) / len(draws)
    step = torch.linalg.solve(covariance, (torch.log(tuples[row]) - logarithm).T)
    carried = coordinates.values(draws + (together @ step).T)
    return {**carried, **{name: tuples[row, column] for column, name in enumerate(names)}}
