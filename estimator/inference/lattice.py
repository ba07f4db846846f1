"""Loop counts are whole numbers: the posterior as a mixture over the lattice of counts.

Around the continuous maximum every plausible tuple of counts gets its own maximum and Laplace covariance in the remaining coordinates; the
table grows until its rim carries no weight. The mixture is the proposal of the sampler and, by itself, already a good approximation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from estimator.inference.laplace import covariance, log_evidence
from estimator.inference.levenberg_marquardt import Optimum, levenberg_marquardt
from estimator.inference.likelihood import LogPosterior

NEGLIGIBLE = 1e-5
MOST_TUPLES, MOST_EFFECTIVE = 600, 200.0
FITS_PER_BATCH = 64
DRAWS, FEWEST_DRAWS = 4000, 8


@dataclass(frozen=True)
class CountMixture:
    """One normal component per tuple of loop counts.

    Attributes:
        counts: Whole numbers, tuple by count; a single empty tuple where no count is free.
        weight: Laplace probability of each tuple; adds up to 1.
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
    """Maxima and weights of all tuples of loop counts that matter; None where they are too many for a table.

    Args:
        continuous: Posterior with real-valued counts.
        integer: The same posterior with whole-numbered counts in the last columns.
        fit: Maximum of `continuous` (the first start is used).
        rng: Draws the tuples to begin with.
    Returns: The mixture, or None where more than `MOST_TUPLES` tuples are plausible: such counts are hardly determined, and real
        numbers describe them as well.
    """
    n_counts = integer.coordinates.n_counts
    if n_counts == 0:
        return _mixture(levenberg_marquardt(integer, fit.vector[:1]), 0)
    generator = torch.Generator().manual_seed(int(rng.integers(2**31)))
    normal = torch.randn(DRAWS, fit.vector.shape[1], generator=generator, dtype=fit.vector.dtype)
    sample = fit.vector[0] + normal @ torch.linalg.cholesky(covariance(fit.precision)[0]).T
    start_of = _starts(continuous, integer, torch.cat((fit.vector[:1], sample)), n_counts)
    if not start_of:
        return None
    fits: dict[tuple[int, ...], Optimum] = {}
    wanted = list(start_of)
    while wanted:
        for begin in range(0, len(wanted), FITS_PER_BATCH):
            batch = wanted[begin : begin + FITS_PER_BATCH]
            fitted = levenberg_marquardt(
                integer, torch.stack([start_of[key] for key in batch]), tolerance=1e-4
            )
            fits.update({key: fitted.rows(slice(i, i + 1)) for i, key in enumerate(batch)})
        weight = _weights(fits)
        matter = [key for key in fits if weight[key] > NEGLIGIBLE]
        if len(matter) > MOST_TUPLES:
            return None
        wanted = []
        for key in matter:
            for neighbour in _neighbours(key):
                if neighbour not in fits and neighbour not in wanted:
                    start_of[neighbour] = _moved(fits[key], neighbour, n_counts)
                    wanted.append(neighbour)
    kept = sorted(key for key in fits if weight[key] > NEGLIGIBLE)
    return _mixture(Optimum.together([fits[key] for key in kept]), n_counts)


def _starts(
    continuous: LogPosterior, integer: LogPosterior, sample: Tensor, n_counts: int
) -> dict[tuple[int, ...], Tensor]:
    """A start for every tuple that the draws round to: the mean of those draws, with the counts rounded; none if too many.

    The number of tuples that matter is estimated as the exponential of the entropy of the draws.
    """
    values = continuous.coordinates.values(sample)
    moved = {
        name: value.round().clamp(min=1.0) if continuous.model.rig.parameters[name].is_count else value
        for name, value in values.items()
    }
    vectors = integer.coordinates.vector(moved)
    keys, which, number = torch.unique(vectors[:, -n_counts:], dim=0, return_inverse=True, return_counts=True)
    share = number / number.sum()
    if float(torch.exp(-(share * torch.log(share)).sum())) > MOST_EFFECTIVE:
        return {}
    allowed = torch.isfinite(integer.coordinates.log_prior(vectors))
    starts: dict[tuple[int, ...], Tensor] = {}
    for i in torch.argsort(number, descending=True)[:MOST_TUPLES].tolist():
        if starts and number[i] < FEWEST_DRAWS:  # neighbours of what matters are visited anyway
            break
        mine = vectors[(which == i) & allowed]
        if len(mine):
            starts[tuple(int(c) for c in keys[i])] = mine.mean(0)
    return starts


def _neighbours(key: tuple[int, ...]) -> list[tuple[int, ...]]:
    steps = [(i, step) for i in range(len(key)) for step in (-1, 1)]
    return [
        tuple(c + step if j == i else c for j, c in enumerate(key)) for i, step in steps if key[i] + step >= 1
    ]


def _moved(fit: Optimum, counts: tuple[int, ...], n_counts: int) -> Tensor:
    start = fit.vector[0].clone()
    start[-n_counts:] = torch.tensor(counts, dtype=start.dtype)
    return start


def _weights(fits: dict[tuple[int, ...], Optimum]) -> dict[tuple[int, ...], float]:
    evidence = torch.cat([log_evidence(fit) for fit in fits.values()])
    return dict(zip(fits, torch.softmax(evidence.nan_to_num(nan=-torch.inf), dim=0).tolist(), strict=True))


def _mixture(fit: Optimum, n_counts: int) -> CountMixture:
    n = fit.vector.shape[1] - n_counts
    weight = torch.softmax(log_evidence(fit), dim=0)
    return CountMixture(fit.vector[:, n:], weight, fit.vector[:, :n], covariance(fit.precision))
