"""Widen intervals by what remains unexplained, and draw parameters as uncertain as that."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from estimator.calibration.policy import FAR_SD
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.structure.jackknife import jackknife_covariance
from estimator.inference.lattice import MOST_EFFECTIVE
from estimator.readings.split import pose_blocks, time_blocks
from estimator.rig.coordinates import Coordinates
from estimator.rig.rig import Rig

# Share of a variance that rounding may leave of a direction of a correlation matrix, or make negative
LEAST_SHARE = 1e-12


class Drawn(NamedTuple):
    """Draws of the parameters, walker by step, and the log density of their law up to a constant."""

    draws: dict[str, np.ndarray]
    log_prob: np.ndarray


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
    def of(cls, searched: Fit, final: Fit, names: Sequence[str], spread: Float[Tensor, "n n"]) -> Widening:
        """The smallest covariance that is nowhere below three others, and nowhere beyond the priors of numbers that these allow.

        These are: the Laplace covariance of the fit; what the mixture says of the rig's numbers, carried to the other numbers as the fit
        ties them to these; and the jackknife over blocks of places and of times, for a wrong model errs where it guesses. A number that the
        fit puts far outside its prior may still lie inside.

        Args:
            searched: The extended rig, fitted to the readings of the search.
            final: The same, fitted to all readings.
            names: Of the rig's numbers.
            spread: Their mean square distance from those of the final fit.
        """
        rows = [final.posterior.coordinates.names.index(name) for name in names]
        among = final.covariance[rows][:, rows]
        following = torch.linalg.solve(among, final.covariance[rows]).T
        growth = envelope(among, spread) - among
        carried = final.covariance + following @ growth @ following.T
        places = pose_blocks(searched.observations, np.random.default_rng(0))
        jackknives = [jackknife_covariance(searched, b) for b in (places, time_blocks(searched.observations))]
        within = within_prior(final, envelope(final.covariance, carried, *jackknives))
        return cls(final, envelope(final.covariance, within, *back_to_priors(final, names)))

    @cached_property
    def factors(self) -> dict[str, float]:
        """Factor by which the standard deviation of each free parameter grows."""
        names = [parameter.name for parameter in self.fit.rig.free]
        return {n: max(1.0, self.fit.value_sd(n, self.covariance) / self.fit.value_sd(n)) for n in names}

    def drawn(self, n_walkers: int, n_steps: int, seed: int) -> Drawn:
        """Draws of the normal law with this covariance about the fit.

        Loop counts are whole where a table can hold those that are plausible: each set has the probability that the law gives it. No draw
        leaves the bounds of its prior, and none is impossible, such as a winding without a radius.

        Args:
            n_walkers, n_steps: Shape of the draws.
            seed: Of the draws.
        Returns: Values of every free parameter, and the log density of the law.
        """
        coordinates, generator = self.fit.posterior.coordinates, torch.Generator().manual_seed(seed)
        n, centre = n_walkers * n_steps, self.fit.vector
        normal = torch.randn(n, len(centre), generator=generator, dtype=centre.dtype)
        vectors = centre + normal @ _roots(self.covariance)[0].T
        values = with_whole_counts(coordinates, vectors, centre, generator)
        lower, upper = coordinates.bounds()
        drawn = torch.stack([values[name] for name in coordinates.names], dim=1).clamp(lower, upper)
        possible = torch.isfinite(drawn).all(1).nonzero().flatten()
        drawn = drawn[possible[torch.arange(n) % len(possible)]] if len(possible) < n else drawn
        shape = (n_walkers, n_steps)
        return Drawn(
            {name: drawn[:, i].reshape(shape).numpy() for i, name in enumerate(coordinates.names)},
            (-0.5 * normal.square().sum(1)).reshape(shape).numpy(),
        )


def within_prior(fit: Fit, covariance: Float[Tensor, "n n"]) -> Float[Tensor, "n n"]:
    """A covariance of a fit's coordinates, narrowed where it says less than the priors do, to some per cent; nowhere below that of the fit.

    The scatter of fits that miss a block each knows no priors: multiplied by the number of blocks it may exceed them by orders.

    Args:
        fit: Its priors count as they are curved at its maximum.
        covariance: Nowhere below that of the fit.
    """
    prior_precision = (fit.optimum.precision - fit.optimum.information)[0]
    root, whitener = _roots(fit.covariance)
    size, turn = torch.linalg.eigh(whitener.T @ covariance @ whitener)
    wide = root @ (turn * torch.sqrt(size.clamp(min=1.0)))
    excess, axes = torch.linalg.eigh(wide.T @ prior_precision @ wide)
    narrowed = wide @ (axes / torch.sqrt(excess.clamp(min=1.0)))
    return envelope(fit.covariance, narrowed @ narrowed.T)


def back_to_priors(fit: Fit, names: Sequence[str]) -> list[Float[Tensor, "n n"]]:
    """Covariances by which each number that lies far from its prior may be off by as much, and the others as they follow it.

    A model that is wrong pulls numbers away: the prior is then more probable than the fit says.

    Args:
        fit: The fit.
        names: Of the numbers.
    """
    result = []
    for name in names:
        prior, value = fit.rig.parameters[name].prior, float(fit.values[name])
        if prior is not None and abs(prior.distance(value)) > FAR_SD:
            gradient = fit.value_gradients[name]
            moved = fit.covariance @ gradient * (value - prior.centre) / fit.value_sd(name) ** 2
            result.append(torch.outer(moved, moved))
    return result


def have_whole_counts(rig: Rig, draws: Mapping[str, np.ndarray]) -> bool:
    """Whether every free loop count of the rig is a whole number in every draw."""
    counts = [draws[parameter.name] for parameter in rig.free if parameter.is_count]
    return all(bool((count == count.round()).all()) for count in counts)


def _roots(covariance: Float[Tensor, "n n"]) -> tuple[Float[Tensor, "n n"], Float[Tensor, "n n"]]:
    """A square root of a covariance, and what makes it a unit matrix from both sides."""
    sd = torch.sqrt(torch.diagonal(covariance))
    share, turn = torch.linalg.eigh(covariance / (sd[:, None] * sd))
    size = torch.sqrt(share.clamp(min=LEAST_SHARE))
    return sd[:, None] * turn * size, turn / size / sd[:, None]


def envelope(covariance: Float[Tensor, "n n"], *others: Float[Tensor, "n n"]) -> Float[Tensor, "n n"]:
    """A covariance that is in no direction below any of these; with one other the smallest, in the principal axes of the pair.

    All others are seen in units of the first covariance. It should therefore be that of a fit: one that was stretched by much in some
    directions has lost the digits of the rest, and a second stretch would make predictions uncertain by what was lost.

    Examples:
        >>> envelope(torch.diag(torch.tensor([1.0, 4.0])), torch.diag(torch.tensor([9.0, 1.0])))
        tensor([[9., 0.],
                [0., 4.]])
    """
    root, whitener = _roots(covariance)
    growth = torch.eye(len(covariance), dtype=covariance.dtype)
    for other in others:
        inward = torch.linalg.solve(growth, whitener.T)
        whitened = inward @ other @ inward.T
        ratio, axes = torch.linalg.eigh(0.5 * (whitened + whitened.T))
        growth = growth @ (axes * torch.sqrt(ratio.clamp(min=1.0))) @ axes.T
    stretched = root @ growth @ whitener.T
    return stretched @ covariance @ stretched.T


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
