"""Loop counts are whole numbers: the posterior as a Laplace mixture over the lattice of counts.

Around the continuous maximum every plausible tuple of counts gets its own maximum and Laplace covariance in the remaining coordinates. The
table grows until its rim carries no weight. The mixture is the proposal of the sampler, and a good approximation by itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from estimator.inference.laplace import log_evidence
from estimator.inference.levenberg_marquardt import Optimum, levenberg_marquardt
from estimator.inference.likelihood import LogPosterior
from estimator.inference.positive_definite import inverse, lower_factor

NEGLIGIBLE = 1e-5
MOST_TUPLES, MOST_EFFECTIVE = 600, 200.0
FITS_PER_BATCH = 64
DRAWS, FEWEST_DRAWS = 4000, 8


@dataclass(frozen=True)
class CountMixture:
    """One normal component per tuple of loop counts.

    Attributes:
        counts: Whole numbers; a single empty tuple if no count is free.
        weight: Laplace probability of each tuple; they add up to 1.
        mean: Maximum in the continuous coordinates.
        covariance: Laplace covariance there.
    """

    counts: Float[Tensor, "tuple count"]
    weight: Float[Tensor, " tuple"]
    mean: Float[Tensor, "tuple continuous"]
    covariance: Float[Tensor, "tuple continuous continuous"]


def count_mixture(
    continuous: LogPosterior, integer: LogPosterior, fit: Optimum, rng: np.random.Generator
) -> CountMixture | None:
    """Maxima and weights of all plausible tuples of loop counts; None if they are too many for a table.

    Args:
        continuous: Posterior with real-valued counts.
        integer: The same posterior with whole-numbered counts in the last columns.
        fit: Maximum of `continuous` (the first start is used).
        rng: Draws the first tuples.
    Returns: The mixture, or None if more than `MOST_TUPLES` tuples are plausible: such counts are hardly determined, and real numbers
        describe them as well.
    """
    n_counts = integer.coordinates.n_counts
    if n_counts == 0:
        return laplace_mixture(levenberg_marquardt(integer, fit.vector[:1]), 0)
    generator = torch.Generator().manual_seed(int(rng.integers(2**31)))
    normal = torch.randn(DRAWS, fit.vector.shape[1], generator=generator, dtype=fit.vector.dtype)
    sample = fit.vector[0] + normal.to(fit.vector) @ lower_factor(inverse(fit.precision)[0]).T
    start_of = _starts(continuous, integer, torch.cat((fit.vector[:1], sample)), n_counts)
    if not start_of:
        return None
    fits: dict[tuple[int, ...], Optimum] = {}
    pending = list(start_of)
    while pending:
        for begin in range(0, len(pending), FITS_PER_BATCH):
            batch = pending[begin : begin + FITS_PER_BATCH]
            fitted = levenberg_marquardt(
                integer, torch.stack([start_of[key] for key in batch]), tolerance=1e-4
            )
            fits.update({key: fitted.rows(slice(i, i + 1)) for i, key in enumerate(batch)})
        weight = _weights(fits)
        plausible = [key for key in fits if weight[key] > NEGLIGIBLE]
        if len(plausible) > MOST_TUPLES:
            return None
        pending = []
        for key in plausible:
            for neighbour in _neighbours(key):
                if neighbour not in fits and neighbour not in pending:
                    start_of[neighbour] = _with_counts(fits[key], neighbour, n_counts)
                    pending.append(neighbour)
    return laplace_mixture(Optimum.concatenated([fits[key] for key in sorted(plausible)]), n_counts)


def _starts(
    continuous: LogPosterior, integer: LogPosterior, sample: Tensor, n_counts: int
) -> dict[tuple[int, ...], Tensor]:
    """A start for every tuple that draws round to: the mean of these draws, with rounded counts; none if tuples are too many.

    The exponential of the entropy of the draws estimates the number of plausible tuples.
    """
    values = continuous.coordinates.values(sample)
    rounded = {
        name: value.round().clamp(min=1.0) if continuous.model.rig.parameters[name].is_count else value
        for name, value in values.items()
    }
    vectors = integer.coordinates.vector(rounded)
    keys, key_of_draw, n_draws = torch.unique(
        vectors[:, -n_counts:], dim=0, return_inverse=True, return_counts=True
    )
    share = n_draws / n_draws.sum()
    if float(torch.exp(-(share * torch.log(share)).sum())) > MOST_EFFECTIVE:
        return {}
    is_allowed = torch.isfinite(integer.coordinates.log_prior(vectors))
    starts: dict[tuple[int, ...], Tensor] = {}
    for i in torch.argsort(n_draws, descending=True)[:MOST_TUPLES].tolist():
        if starts and n_draws[i] < FEWEST_DRAWS:  # neighbours of plausible tuples are tried anyway
            break
        draws = vectors[(key_of_draw == i) & is_allowed]
        if len(draws):
            starts[tuple(int(count) for count in keys[i])] = draws.mean(0)
    return starts


def _neighbours(key: tuple[int, ...]) -> list[tuple[int, ...]]:
    steps = [(i, step) for i in range(len(key)) for step in (-1, 1)]
    return [
        tuple(c + step if j == i else c for j, c in enumerate(key)) for i, step in steps if key[i] + step >= 1
    ]


def _with_counts(fit: Optimum, counts: tuple[int, ...], n_counts: int) -> Tensor:
    start = fit.vector[0].clone()
    start[-n_counts:] = torch.tensor(counts, dtype=start.dtype)
    return start


def _weights(fits: dict[tuple[int, ...], Optimum]) -> dict[tuple[int, ...], float]:
    log_evidences = torch.cat([log_evidence(fit) for fit in fits.values()])
    return dict(
        zip(fits, torch.softmax(log_evidences.nan_to_num(nan=-torch.inf), dim=0).tolist(), strict=True)
    )


def laplace_mixture(fit: Optimum, n_counts: int) -> CountMixture:
    """One normal component for each maximum, weighted by its evidence; the last coordinates are counts."""
    n = fit.vector.shape[1] - n_counts
    weight = torch.softmax(log_evidence(fit), dim=0)
    return CountMixture(fit.vector[:, n:], weight, fit.vector[:, :n], inverse(fit.precision))
