"""Widen intervals, and posterior draws, by what remains unexplained."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from estimator.derivatives import jacobian_of
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.least_growth import least_growth
from estimator.diagnosis.structure.cross_validation import jackknife_covariance
from estimator.diagnosis.structure.discrepancy import Discrepancy
from estimator.readings.split import pose_blocks, time_blocks
from estimator.rig.coordinates import Coordinates

LEAST_SHARE = (
    1e-12  # of a variance: what rounding may leave of a direction of a correlation matrix, or make negative
)


@dataclass(frozen=True)
class Widening:
    """Uncertainty of a fit where something remains unexplained.

    Attributes:
        fit: The fit whose intervals grow.
        covariance: Widened covariance of its coordinates.
    """

    fit: Fit
    covariance: Float[Tensor, "coordinate coordinate"]

    @classmethod
    def of(cls, searched: Fit, fit: Fit, remainder: Discrepancy) -> Widening:
        """The smallest covariance that is nowhere below three others.

        These are: the Laplace covariance of the fit; that of the search with the strongest remaining curve fitted as well; and the block
        jackknife over neighbouring positions. The last two use the few readings of the search, for the error of a wrong model does not
        average out over more.

        Args:
            searched: The last fit of the search.
            fit: The same model, fitted to all readings.
            remainder: Structure in the residual at the end of the search.
        """
        block = pose_blocks(searched.observations, np.random.default_rng(0))
        others = (searched.covariance_beside(remainder.columns), jackknife_covariance(searched, block))
        return cls(fit, envelope(fit.covariance, *others))

    def carried_to(self, fit: Fit) -> Widening:
        """The widening of a fit with further terms: no parameter that both fits have is surer than this one says.

        Ties between parameters are not carried: where the further terms have moved the fit far, numbers that made up for each other no
        longer do. Of all covariances with such intervals the one is taken that the later fit contradicts least, and the further terms go
        along as its posterior has it. So the field that all predict together grows little less sure.

        Args:
            fit: With corrections.
        """
        names, own = fit.posterior.coordinates.names, self.fit.posterior.coordinates.names
        shared = [name for name in own if name in names]
        rows, own_rows = [names.index(name) for name in shared], [own.index(name) for name in shared]
        among = fit.covariance[rows][:, rows]
        growth = least_growth(among, self.covariance.diagonal()[own_rows])
        following = torch.linalg.solve(among, fit.covariance[rows]).T
        return Widening(fit, fit.covariance + following @ growth @ following.T)

    def over_blocks(self, searched: Fit) -> Widening:
        """The widening that is also nowhere surer than predictions of readings held out allow, by place and by time.

        What follows a rest without a name is a wrong model where it guesses: between places, or between times. Neither the noise nor the
        priors of its amplitudes know of that; the scatter of a fit, as one block after another is left out, does.

        Args:
            searched: The same model, fitted to the few readings of the search.
        """
        blocks = (
            pose_blocks(searched.observations, np.random.default_rng(0)),
            time_blocks(searched.observations),
        )
        others = (jackknife_covariance(searched, block) for block in blocks)
        return Widening(self.fit, envelope(self.fit.covariance, self.covariance, *others))

    @cached_property
    def factors(self) -> dict[str, float]:
        """Factor by which the standard deviation of each free parameter grows."""
        names = [parameter.name for parameter in self.fit.rig.free]
        return {n: max(1.0, self.fit.value_sd(n, self.covariance) / self.fit.value_sd(n)) for n in names}

    def spread(self, coordinates: Coordinates, draws: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Posterior draws of the same model, stretched about their mean until their covariance is nowhere below this one.

        Whole loop counts and their probabilities stay: the draws of each are stretched about their own mean. No draw leaves the bounds of
        its prior.

        Args:
            coordinates: Of the rig that was sampled.
            draws: Of every free parameter, walker by step.
        """
        flat = {name: torch.from_numpy(array.reshape(-1)) for name, array in draws.items()}
        vector = coordinates.vector(flat)
        continuous, counts = vector.tensor_split([coordinates.n_continuous], dim=1)
        mean = _mean_by_counts(counts, continuous)
        deviation = continuous - mean
        sampled = deviation.T @ deviation / len(deviation)
        wider = mean + deviation @ stretch(sampled, self._given_counts(coordinates)).T
        values = coordinates.values(torch.cat((wider, counts), dim=1))
        lower, upper = coordinates.bounds()
        return {
            name: values[name].clamp(lower[i], upper[i]).reshape(draws[name].shape).numpy()
            for i, name in enumerate(coordinates.names)
        }

    def _given_counts(self, coordinates: Coordinates) -> Float[Tensor, "continuous continuous"]:
        """The covariance in other coordinates of the same parameters, given the whole counts."""
        own_coordinates = self.fit.posterior.coordinates
        names = coordinates.names

        def transformed(vector: Tensor) -> Tensor:
            return coordinates.vector({name: own_coordinates.values(vector)[name] for name in names})

        jacobian = jacobian_of(transformed, self.fit.vector)
        covariance = jacobian @ self.covariance @ jacobian.T
        n = coordinates.n_continuous
        cross = covariance[:n, n:]
        given: Tensor = covariance[:n, :n] - cross @ torch.linalg.solve(covariance[n:, n:], cross.T)
        return given


def _mean_by_counts(
    counts: Float[Tensor, "draw count"], continuous: Float[Tensor, "draw coordinate"]
) -> Float[Tensor, "draw coordinate"]:
    """Mean of the coordinates over all draws with the same counts, for each draw."""
    if not counts.shape[1]:
        return continuous.mean(dim=0).expand_as(continuous)
    _, group, size = torch.unique(counts, dim=0, return_inverse=True, return_counts=True)
    total = torch.zeros(len(size), continuous.shape[1], dtype=continuous.dtype).index_add(
        0, group, continuous
    )
    mean: Tensor = total / size[:, None]
    return mean[group]


def envelope(covariance: Float[Tensor, "n n"], *others: Float[Tensor, "n n"]) -> Float[Tensor, "n n"]:
    """A covariance that is in no direction below any of these; with one other the smallest, in the principal axes of the pair.

    Examples:
        >>> envelope(torch.diag(torch.tensor([1.0, 4.0])), torch.diag(torch.tensor([9.0, 1.0])))
        tensor([[9., 0.],
                [0., 4.]])
    """
    stretched = stretch(covariance, *others)
    return stretched @ covariance @ stretched.T


def stretch(covariance: Float[Tensor, "n n"], *others: Float[Tensor, "n n"]) -> Float[Tensor, "n n"]:
    """The linear map from a covariance to its envelope with others; directions that are wide enough stay.

    All others are seen in units of the first covariance. It should therefore be that of a fit: one that was stretched by much in some
    directions has lost the digits of the rest, and a second stretch would make predictions uncertain by what was lost.

    Examples:
        >>> stretch(torch.diag(torch.tensor([1.0, 4.0])), torch.diag(torch.tensor([9.0, 1.0])))
        tensor([[3., 0.],
                [0., 1.]])
    """
    sd = torch.sqrt(torch.diagonal(covariance))
    share, turn = torch.linalg.eigh(covariance / (sd[:, None] * sd))
    root = turn * torch.sqrt(share.clamp(min=LEAST_SHARE))
    whitener = turn / torch.sqrt(share.clamp(min=LEAST_SHARE))
    growth = sd.new_ones(len(sd)).diag()
    for other in others:
        inward = torch.linalg.solve(growth, whitener.T / sd)
        whitened = inward @ other @ inward.T
        ratio, axes = torch.linalg.eigh(0.5 * (whitened + whitened.T))
        growth = growth @ (axes * torch.sqrt(ratio.clamp(min=1.0))) @ axes.T
    stretched: Tensor = sd[:, None] * (root @ growth @ whitener.T) / sd
    return stretched
