"""Fits to the readings that do not miss by far, whatever the others hold: least trimmed squares.

A fit is made to the better part of the readings, those that miss it least are the better part of the next, and so on.

References: the concentration steps of least trimmed squares, Rousseeuw and Van Driessen, Technometrics 41, 212 (1999).
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from estimator.diagnosis import effort, policy
from estimator.diagnosis.expectation import SD_OF_MEDIAN, Expectation, predict_T
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.inference.bounds import Inside
from estimator.inference.levenberg_marquardt import prior_gradient
from estimator.readings.observations import Observations
from estimator.readings.split import spread

# The first of them, to the rest that misses least: one to all readings may leave none near
TRIMMINGS_TO_A_SHARE = 2
MOST_TRIMMINGS = 5  # fits to the readings that do not miss by far, one after another: most settle after three

STEPS_FOR_A_FIT = 2  # with the slopes of another place, which come as near as a new fit


def robust_fit(fit: Fit, values: Mapping[str, Tensor], observations: Observations) -> Fit:
    """The fit to readings that do not miss by far: first to the better half and some more of them, then to all that are near that fit.

    Args:
        fit: To some of the readings, whatever they hold.
        values: Where the first of those fits starts from.
        observations: The readings.
    """
    may_fit = observations.is_measured.any(dim=1) & ~observations.is_validation
    for trimming in range(MOST_TRIMMINGS):
        is_near = _are_near(predict_T(fit, values, observations), observations, may_fit, trimming)
        if is_near is None:
            return fit
        few = spread(observations.rows(is_near), effort.MOST_READINGS_SEARCHED)
        is_settled = trimming >= TRIMMINGS_TO_A_SHARE and len(few) == len(fit.observations)
        fit = fit_rig(fit.rig, few, values, fit.posterior.model.rules, tolerance=effort.ROUGH_TOLERANCE)
        values = fit.values
        if is_settled:
            break
    return fit


def robust_values(fit: Fit) -> Mapping[str, Tensor]:
    """Values of a rig by the readings of its fit that do not miss by far, with the slopes that the fit has.

    No fit is made again, which takes long where a rig has many causes: each step is that of Gauss and Newton with the predictions of its
    place and the Jacobian of the first.

    Args:
        fit: To the readings, whatever some of them hold.
    """
    observations, posterior = fit.observations, fit.posterior
    may_fit = observations.is_measured.any(dim=1)
    reading = posterior.measured_components(torch.arange(len(observations))[:, None].expand(-1, 3))
    vector, values = fit.vector, fit.values
    for trimming in range(STEPS_FOR_A_FIT * MOST_TRIMMINGS):
        field_T = predict_T(fit, values, observations)
        is_near = _are_near(field_T, observations, may_fit, trimming)
        if is_near is None:
            return fit.values
        residual = (posterior.measured_T - posterior.measured_components(field_T)) * fit.whitening_per_T
        counts = is_near[reading]
        residual, jacobian = residual[counts], fit.jacobian[counts]
        # Errors of the others made the noise of the fit too large.
        scale = (SD_OF_MEDIAN * residual.abs().median()).clamp(max=1.0)
        residual, jacobian = residual / scale, jacobian / scale
        gradient = jacobian.T @ residual + prior_gradient(posterior.coordinates, vector)
        precision = jacobian.T @ jacobian + fit.prior_precision
        moved = vector + Inside(posterior.coordinates, vector).step_of_the_free(precision, gradient)
        if not bool(torch.isfinite(posterior.coordinates.log_prior(moved))):
            break
        vector, values = moved, posterior.coordinates.values(moved)
    return values


def _are_near(
    predicted_T: Float[Tensor, "reading 3"],
    observations: Observations,
    may_fit: Bool[Tensor, " reading"],
    trimming: int,
) -> Bool[Tensor, " reading"] | None:
    """The readings that the next of these fits is made to; None where they are too few to tell which are right."""
    off = Expectation(observations, predicted_T).misses
    is_first = trimming < TRIMMINGS_TO_A_SHARE
    most = off[may_fit].quantile(1.0 - policy.MOST_TRIMMED) if is_first else policy.FAR_FROM_EXPECTED
    is_near = may_fit & (off <= most)
    return is_near if int(is_near.sum()) >= int((1.0 - policy.MOST_TRIMMED) * float(may_fit.sum())) else None
