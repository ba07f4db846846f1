"""What a calibration knows before it samples: the maximum, the proposal, and the density that is left to sample."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from estimator.calibration.next_degree import next_degree_gain
from estimator.inference.collapsed import CollapsedPosterior, free_amplitudes
from estimator.inference.collapsed_estimate import collapsed_estimate
from estimator.inference.convergence import Convergence
from estimator.inference.density import Density
from estimator.inference.ensemble import SamplerSettings, Samples, reported_parameters
from estimator.inference.laplace import OpenDirection, open_directions
from estimator.inference.lattice import CountMixture, count_mixture, laplace_mixture
from estimator.inference.likelihood import LogPosterior
from estimator.inference.point_estimate import PointEstimate, point_estimate
from estimator.readings.observations import Observations


@dataclass(frozen=True)
class StartingPoint:
    """The maximum of a posterior and what is sampled about it.

    Attributes:
        posterior: Density that is sampled: of all free parameters, or of those that are left where amplitudes are integrated out.
        mixture: Its Laplace mixture over loop counts.
        estimate: Its maximum, with loop counts as real numbers.
        values: Every number of the rig there.
        undetermined: What the data do not determine.
    """

    posterior: Density
    mixture: CountMixture
    estimate: PointEstimate
    values: dict[str, Tensor]
    undetermined: tuple[OpenDirection, ...]

    def best(self) -> dict[str, float]:
        """Every number of the rig at the maximum, with the most probable whole loop counts."""
        top = int(self.mixture.weight.argmax())
        vector = torch.cat((self.mixture.mean[top], self.mixture.counts[top]))
        return {name: float(value) for name, value in self.posterior.values(vector).items()}

    def draws(self, chain: np.ndarray, seed: int) -> dict[str, np.ndarray]:
        """Draws of every free parameter, walker by step, from a chain of coordinates with axes step, walker and coordinate."""
        coordinates = self.posterior.coordinates
        reported = reported_parameters(coordinates, chain) if coordinates.n else chain
        draws = {name: reported[:, :, i] for i, name in enumerate(coordinates.names)}
        draws |= self.posterior.drawn(chain, seed)
        return {name: np.ascontiguousarray(array.T) for name, array in draws.items()}

    def summary(self, observations: Observations) -> dict[str, Any]:
        """What is said of coils without a winding: amplitudes by coil, free and determined, and the evidence for a degree more."""
        if not isinstance(self.posterior, CollapsedPosterior):
            return {}
        vector = self.mixture.mean[0]
        counts = self.posterior.determined(vector)
        return {
            "amplitudes": {coil: {"free": n, "determined": told} for coil, (n, told) in counts.items()},
            "next_degree_log_evidence": next_degree_gain(self.posterior, observations, vector),
        }


def is_collapsible(posterior: LogPosterior) -> bool:
    """Whether the posterior has amplitudes that can be integrated out in closed form."""
    return bool(free_amplitudes(posterior.coordinates.rig)) and CollapsedPosterior(posterior).is_linear


def starting_point_collapsed(posterior: LogPosterior, observations: Observations, seed: int) -> StartingPoint:
    """The maximum and the proposal where amplitudes are integrated out.

    Args:
        posterior: Density of all free parameters, loop counts as real numbers.
        observations: The readings.
        seed: Of starts and thinning.
    """
    collapsed = CollapsedPosterior(posterior)
    estimate = collapsed_estimate(collapsed, observations, seed)
    with torch.no_grad():
        model = posterior.model.choose_rules(collapsed.values(estimate.vector))
    collapsed = CollapsedPosterior(LogPosterior(posterior.coordinates, model, observations))
    undetermined = tuple(open_directions(collapsed.coordinates, estimate.fit))
    with torch.no_grad():
        values = collapsed.values(estimate.vector)
    return StartingPoint(collapsed, laplace_mixture(estimate.fit, 0), estimate, values, undetermined)


def starting_point_with_counts(
    posterior: LogPosterior,
    observations: Observations,
    seed: int,
    lattice_of: Callable[[LogPosterior], LogPosterior],
    tell: Callable[[str, tuple[OpenDirection, ...]], None],
    near: Mapping[str, float] | None = None,
) -> StartingPoint:
    """The maximum and the mixture over whole loop counts, where all free parameters are sampled.

    Args:
        posterior: Density of all free parameters, loop counts as real numbers.
        observations: The readings.
        seed: Of starts, thinning and tuples.
        lattice_of: The same density with whole-numbered counts in the last columns.
        tell: Called with the name of each stage and what the data do not determine.
        near: Values of the free parameters near the maximum, where they are known.
    """
    coordinates = posterior.coordinates
    begin = None if near is None else coordinates.vector(near)
    estimate = point_estimate(posterior, observations, seed, begin)
    with torch.no_grad():
        values = coordinates.values(estimate.vector)
        # A fit to fields in another unit may draw the winding around a sensor; the calibration then says that it misses them.
        model = posterior.model.choose_rules(values, is_refusing=False)
    posterior = LogPosterior(coordinates, model, observations)
    undetermined = tuple(open_directions(coordinates, estimate.fit))
    tell("Laplace approximation over loop counts", undetermined)
    rng = np.random.default_rng(seed)
    lattice = lattice_of(posterior)
    mixture = count_mixture(posterior, lattice, estimate.fit, rng)
    if mixture is None:
        tell("loop counts are hardly determined and are sampled as real numbers", ())
        lattice = posterior
        mixture = count_mixture(posterior, lattice, estimate.fit, rng)
        assert mixture is not None
    return StartingPoint(lattice, mixture, estimate, values, undetermined)


def independent(posterior: Density, settings: SamplerSettings) -> Samples:
    """Samples of a posterior in which nothing but amplitudes is free: independent draws without coordinates, as many as are wanted."""
    walkers = max(settings.n_walkers, 1)
    steps = int(np.ceil(settings.target_ess / walkers))
    n, none = float(steps * walkers), np.zeros(0)
    log_prob = np.full((steps, walkers), float(posterior(posterior.coordinates.start()[None])[0]))
    reached = Convergence(np.array([n]), np.array([n]), np.array([1.0]))
    return Samples(np.zeros((steps, walkers, len(none))), log_prob, reached, True, 1.0, steps)
