"""Point estimate: Nelder-Mead from many starts on a thinned session, then Levenberg-Marquardt on all of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from estimator.inference.levenberg_marquardt import Optimum, levenberg_marquardt
from estimator.inference.likelihood import LogPosterior
from estimator.inference.nelder_mead import initial_simplex, minimise
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.rig.coordinates import Coordinates

THIN_TO = 100  # readings that Nelder-Mead sees: it has to find the valley, not its floor
N_STARTS = 12
MOST_ITERATIONS = 200


@dataclass(frozen=True)
class PointEstimate:
    """The maximum of the posterior with continuous loop counts.

    Attributes:
        fit: The maximum and its curvature (one start).
        n_evaluations: Of Nelder-Mead, all starts together.
        n_agreeing: Starts that ended within one unit of log density of the best, of `n_starts`.
    """

    fit: Optimum
    n_evaluations: int
    n_agreeing: int
    n_starts: int

    @property
    def vector(self) -> Float[Tensor, " coordinate"]:
        """Coordinates of the maximum."""
        return self.fit.vector[0]


def point_estimate(posterior: LogPosterior, observations: Observations, seed: int) -> PointEstimate:
    """Find the maximum of the posterior.

    Nelder-Mead starts from the nominal values and from draws of the prior, with simplexes as wide as a quarter of the prior, so that
    parameters that start at zero move (erratum to the paper's Table 8).

    Args:
        posterior: Density with continuous counts over all readings.
        observations: The same readings.
        seed: Of starts and thinning.
    References: Nelder and Mead, Comput. J. 7, 308 (1965); DESIGN decision 5.
    """
    rng = np.random.default_rng(seed)
    coordinates = posterior.coordinates
    thin = _thinned(posterior, observations, rng)
    starts = torch.cat((coordinates.start()[None], coordinates.sample_prior(rng, N_STARTS - 1)))
    starts = starts[torch.isfinite(thin(starts))]
    found = minimise(
        lambda vector: -thin(vector),
        initial_simplex(starts, 0.25 * coordinates.scale),
        x_tolerance=0.02 * coordinates.scale,
        f_tolerance=0.1,
        max_iterations=MOST_ITERATIONS,
        n_restarts=1,
    )
    ends = levenberg_marquardt(thin, found.points)
    best = ends.log_posterior.max()
    n_agreeing = int((ends.log_posterior > best - 1.0).sum())
    candidates = _distinct(ends.vector[ends.log_posterior > best - 30.0], coordinates.scale)
    fits = levenberg_marquardt(posterior, candidates)
    top = int(fits.log_posterior.argmax())
    fit = fits.rows(slice(top, top + 1))
    return PointEstimate(fit, int(found.n_evaluations.sum()), n_agreeing, len(starts))


def _thinned(posterior: LogPosterior, observations: Observations, rng: np.random.Generator) -> LogPosterior:
    if len(observations) <= THIN_TO:
        return posterior
    rows = torch.from_numpy(np.sort(rng.choice(len(observations), THIN_TO, replace=False)))
    few = observations.rows(rows)
    return LogPosterior(
        Coordinates(posterior.coordinates.rig), MeasurementModel.build(posterior.coordinates.rig, few), few
    )


def _distinct(vectors: Tensor, scale: Tensor, most: int = 3) -> Tensor:
    """The first few that differ from each other by more than a thousandth of the prior's width."""
    kept: list[Tensor] = []
    for vector in vectors:
        if all(((vector - other).abs() > 1e-3 * scale).any() for other in kept):
            kept.append(vector)
    return torch.stack(kept[:most])
