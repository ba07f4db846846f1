"""Point estimate: Nelder-Mead from many starts on a thinned session, then Levenberg-Marquardt on all of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from estimator.inference.levenberg_marquardt import Optimum, levenberg_marquardt
from estimator.inference.likelihood import LogPosterior
from estimator.inference.nelder_mead import NelderMeadResult, initial_simplex, minimise
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.rig.coordinates import Coordinates

THIN_TO = 100  # readings for Nelder-Mead, which has to find the basin, not the minimum
N_STARTS = 12
MOST_CANDIDATES = 3  # maxima of Nelder-Mead that are climbed on
MOST_ITERATIONS = 200


@dataclass(frozen=True)
class PointEstimate:
    """The maximum of the posterior with continuous loop counts.

    Attributes:
        fit: The maximum and its curvature (one start).
        n_evaluations: Evaluations of the posterior by Nelder-Mead, over all starts.
        n_agreeing: Number of starts that ended within one unit of log density of the best.
        n_starts: Number of starts.
    """

    fit: Optimum
    n_evaluations: int
    n_agreeing: int
    n_starts: int

    @property
    def vector(self) -> Float[Tensor, " coordinate"]:
        """Coordinates of the maximum."""
        return self.fit.vector[0]


def point_estimate(
    posterior: LogPosterior,
    observations: Observations,
    seed: int,
    near: Float[Tensor, " coordinate"] | None = None,
) -> PointEstimate:
    """Find the maximum of the posterior.

    Nelder-Mead starts from the nominal values and from draws of the prior. Its simplexes are a quarter of the prior wide, so that
    parameters that start at zero move (erratum to the paper's Table 8).

    Args:
        posterior: Density with continuous counts over all readings.
        observations: The same readings.
        seed: Seed of starts and thinning.
        near: Coordinates near the maximum, where they are known: only the climb from there is made.
    References: Nelder and Mead, Comput. J. 7, 308 (1965); docs/paper.md, Solvers.
    """
    if near is not None:
        return PointEstimate(levenberg_marquardt(posterior, near[None]), 0, 1, 1)
    rng = np.random.default_rng(seed)
    coordinates = posterior.coordinates
    thinned = thinned_posterior(posterior, observations, rng)
    simplexes = basins(thinned, coordinates, rng)
    thinned_fits = levenberg_marquardt(thinned, simplexes.points)
    best = thinned_fits.log_posterior.max()
    n_agreeing = int((thinned_fits.log_posterior > best - 1.0).sum())
    is_candidate = thinned_fits.log_posterior > best - 30.0
    candidates = distinct(thinned_fits.vector[is_candidate], coordinates.scale)
    fits = levenberg_marquardt(posterior, candidates)
    return PointEstimate(
        fits.highest(), int(simplexes.n_evaluations.sum()), n_agreeing, len(simplexes.points)
    )


def thinned_posterior(
    posterior: LogPosterior, observations: Observations, rng: np.random.Generator
) -> LogPosterior:
    """The density of a random part of the readings."""
    if len(observations) <= THIN_TO:
        return posterior
    rows = torch.from_numpy(np.sort(rng.choice(len(observations), THIN_TO, replace=False))).to(
        observations.device
    )
    selected = observations.rows(rows)
    rig = posterior.coordinates.rig
    return LogPosterior(Coordinates(rig), MeasurementModel.build(rig, selected), selected)


def basins(
    density: Callable[[Tensor], Tensor], coordinates: Coordinates, rng: np.random.Generator
) -> NelderMeadResult:
    """Roughly the maxima of a density, by Nelder-Mead from the nominal values and from draws of the prior.

    Args:
        density: Log density, batched over rows.
        coordinates: Its coordinates.
        rng: Of the draws.
    """
    starts = torch.cat((coordinates.start()[None], coordinates.sample_prior(rng, N_STARTS - 1)))
    starts = starts[torch.isfinite(density(starts))]
    return minimise(
        lambda vector: -density(vector),
        initial_simplex(starts, 0.25 * coordinates.scale),
        x_tolerance=0.02 * coordinates.scale,
        f_tolerance=0.1,
        max_iterations=MOST_ITERATIONS,
        n_restarts=1,
    )


def distinct(
    vectors: Float[Tensor, "start coordinate"], scale: Float[Tensor, " coordinate"]
) -> Float[Tensor, "few coordinate"]:
    """The first vectors that differ from each other by more than a thousandth of the prior's width."""
    apart: list[Tensor] = []
    for vector in vectors:
        if all(((vector - earlier).abs() > 1e-3 * scale).any() for earlier in apart):
            apart.append(vector)
    return torch.stack(apart[:MOST_CANDIDATES])
