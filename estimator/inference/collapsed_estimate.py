"""Maximum of a posterior whose amplitudes are integrated out: Nelder-Mead from many starts, then damped Newton steps."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from estimator.inference.collapsed import CollapsedPosterior
from estimator.inference.levenberg_marquardt import Optimum
from estimator.inference.point_estimate import PointEstimate, basins, distinct, thinned_posterior
from estimator.inference.positive_definite import solve
from estimator.readings.observations import Observations

MOST_STEPS = 40
DIFFERENCE = 1e-3  # of a standard deviation: the density is a parabola over that, and its rounding a millionth of the change
TOLERANCE = 1e-6  # in log density
LARGEST_DAMPING = 1e8


def collapsed_estimate(posterior: CollapsedPosterior, observations: Observations, seed: int) -> PointEstimate:
    """Find the maximum of the density of all but the amplitudes.

    Args:
        posterior: Density over all readings.
        observations: The same readings.
        seed: Seed of starts and thinning.
    Returns: The maximum in the coordinates of `posterior`, which may be none.
    """
    coordinates = posterior.coordinates
    if not coordinates.n:
        vector = coordinates.start()[None]
        matrix = vector.new_zeros(1, 0, 0)
        fit = Optimum(vector, posterior(vector), matrix, matrix, vector.new_ones(1, dtype=torch.bool), 0)
        return PointEstimate(fit, 0, 1, 1)
    rng = np.random.default_rng(seed)
    rough = CollapsedPosterior(thinned_posterior(posterior.full, observations, rng))
    simplexes = basins(rough, coordinates, rng)
    value = rough(simplexes.points)
    order = torch.argsort(value, descending=True)
    n_agreeing = int((value > value.max() - 1.0).sum())
    candidates = distinct(simplexes.points[order], coordinates.scale)
    fits = Optimum.concatenated([_climbed(posterior, candidate) for candidate in candidates])
    return PointEstimate(
        fits.highest(), int(simplexes.n_evaluations.sum()), n_agreeing, len(simplexes.points)
    )


def _climbed(posterior: CollapsedPosterior, start: Float[Tensor, " coordinate"]) -> Optimum:
    """Climb to the nearest maximum; every step raises the density."""
    vector, value, damping, is_converged, step = start, posterior(start[None])[0], 1e-3, False, 0
    for step in range(1, MOST_STEPS + 1):  # noqa: B007 - reported
        precision, information = posterior.curvature(vector)
        gradient = _gradient(posterior, vector, value, torch.diagonal(precision).rsqrt())
        if float(gradient @ solve(precision, gradient)) < TOLERANCE:
            is_converged = True
            break
        while damping < LARGEST_DAMPING:
            damped = precision + damping * torch.diag(torch.diagonal(precision))
            trial = vector + solve(damped, gradient)
            trial_value = posterior(trial[None])[0]
            if trial_value > value:
                vector, value, damping = trial, trial_value, 0.1 * damping
                break
            damping *= 10.0
        else:  # no step raises it any more: the maximum to rounding, or at a bound
            break
    return Optimum(
        vector[None],
        value[None],
        precision[None],
        information[None],
        torch.tensor([is_converged], device=vector.device),
        step,
    )


def _gradient(
    posterior: CollapsedPosterior, vector: Tensor, value: Tensor, sd: Float[Tensor, " coordinate"]
) -> Float[Tensor, " coordinate"]:
    """Central differences over a small part of each standard deviation; one-sided at a bound."""
    offsets = torch.diag(DIFFERENCE * sd)
    above, below = posterior(torch.cat((vector + offsets, vector - offsets))).view(2, -1)
    up = torch.where(torch.isfinite(above), above - value, 0.0)
    down = torch.where(torch.isfinite(below), value - below, 0.0)
    n_sides = torch.isfinite(above).double() + torch.isfinite(below).double()
    return (up + down) / (n_sides.clamp(min=1.0) * DIFFERENCE * sd)
