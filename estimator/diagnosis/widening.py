"""How much wider intervals are for what remains unexplained, and posterior draws spread to that width."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, reduce

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.func import jacfwd

from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.structure.cross_validation import jackknife_covariance
from estimator.diagnosis.structure.discrepancy import Discrepancy
from estimator.readings.split import pose_blocks
from estimator.rig.coordinates import Coordinates

LEAST_SHARE = 1e-12  # of a variance, for what follows from others but for rounding


@dataclass(frozen=True)
class Widening:
    """What a fit does not know for what remains unexplained.

    Attributes:
        fit: Whose intervals grow.
        covariance: Of its coordinates, with that.
    """

    fit: Fit
    covariance: Float[Tensor, "coordinate coordinate"]

    @classmethod
    def of(cls, searched: Fit, fit: Fit, left: Discrepancy) -> Widening:
        """The least covariance that makes nothing surer than three counts do.

        That of the fit; that of the search if the strongest curve that is left may be in the readings as well; and that by which blocks of
        neighbouring places disagree. The last two are of the few readings of the search, for what a wrong model leaves does not average
        out over more.

        Args:
            searched: The last fit of the search.
            fit: The same model, fitted to all readings.
            left: What the search left.
        """
        block = pose_blocks(searched.observations, np.random.default_rng(0))
        others = (searched.covariance_beside(left.columns), jackknife_covariance(searched, block))
        return cls(fit, reduce(envelope, others, fit.covariance))

    @cached_property
    def factors(self) -> dict[str, float]:
        """By which factor the standard deviation of each free parameter grows."""
        names = [parameter.name for parameter in self.fit.rig.free]
        return {n: max(1.0, self.fit.value_sd(n, self.covariance) / self.fit.value_sd(n)) for n in names}

    def spread(self, coordinates: Coordinates, draws: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Posterior draws of the same model, spread about their mean until they are nowhere surer than this.

        Whole loop counts stay as they are, and so do their probabilities: what belongs to each is spread about its own mean. No draw leaves
        its prior's bounds.

        Args:
            coordinates: Those of the rig that was sampled.
            draws: Of every free parameter, walker by step.
        """
        flat = {name: torch.from_numpy(array.reshape(-1)) for name, array in draws.items()}
        vector = coordinates.vector(flat)
        known, counts = vector.tensor_split([coordinates.n_continuous], dim=1)
        middle = _means_of_same(counts, known)
        off = known - middle
        own = off.T @ off / len(off)
        wider = middle + off @ stretch(own, self._given_counts(coordinates)).T
        values = coordinates.values(torch.cat((wider, counts), dim=1))
        lower, upper = coordinates.bounds()
        return {
            name: values[name].clamp(lower[i], upper[i]).reshape(draws[name].shape).numpy()
            for i, name in enumerate(coordinates.names)
        }

    def _given_counts(self, coordinates: Coordinates) -> Float[Tensor, "continuous continuous"]:
        """The covariance in other coordinates of the same parameters, where whole counts are known."""
        here, at = self.fit.posterior.coordinates, self.fit.vector
        names = coordinates.names

        def there(vector: Tensor) -> Tensor:
            return coordinates.vector({name: here.values(vector)[name] for name in names})

        slope: Tensor = jacfwd(there)(at)
        covariance = slope @ self.covariance @ slope.T
        n = coordinates.n_continuous
        across = covariance[:n, n:]
        given: Tensor = covariance[:n, :n] - across @ torch.linalg.solve(covariance[n:, n:], across.T)
        return given


def _means_of_same(
    counts: Float[Tensor, "draw count"], known: Float[Tensor, "draw coordinate"]
) -> Float[Tensor, "draw coordinate"]:
    """For each draw the mean of those with the same counts."""
    if not counts.shape[1]:
        return known.mean(dim=0).expand_as(known)
    _, group, size = torch.unique(counts, dim=0, return_inverse=True, return_counts=True)
    total = torch.zeros(len(size), known.shape[1], dtype=known.dtype).index_add(0, group, known)
    mean: Tensor = total / size[:, None]
    return mean[group]


def envelope(own: Float[Tensor, "n n"], other: Float[Tensor, "n n"]) -> Float[Tensor, "n n"]:
    """The least covariance, in the axes of the pair, that is in no direction smaller than either.

    Examples:
        >>> envelope(torch.diag(torch.tensor([1.0, 4.0])), torch.diag(torch.tensor([9.0, 1.0])))
        tensor([[9., 0.],
                [0., 4.]])
    """
    move = stretch(own, other)
    return move @ own @ move.T


def stretch(own: Float[Tensor, "n n"], other: Float[Tensor, "n n"]) -> Float[Tensor, "n n"]:
    """The map that takes what has one covariance to the envelope with another; it moves nothing along what is wide enough.

    Examples:
        >>> stretch(torch.diag(torch.tensor([1.0, 4.0])), torch.diag(torch.tensor([9.0, 1.0])))
        tensor([[3., 0.],
                [0., 1.]])
    """
    sd = torch.sqrt(torch.diagonal(own))
    correlation = own / (sd[:, None] * sd) + LEAST_SHARE * torch.eye(len(own), dtype=own.dtype)
    root = sd[:, None] * torch.linalg.cholesky(correlation)
    inside = torch.linalg.solve_triangular(root, other, upper=False)
    inside = torch.linalg.solve_triangular(root, inside.T, upper=False)
    ratio, axes = torch.linalg.eigh(0.5 * (inside + inside.T))
    grown = (axes * torch.sqrt(ratio.clamp(min=1.0))) @ axes.T
    moved: Tensor = torch.linalg.solve_triangular(root, root @ grown, upper=False, left=False)
    return moved
