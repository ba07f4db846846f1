"""Levenberg-Marquardt with secants: between exact Jacobians, each step corrects the last one by what it has shown.

Where many numbers are free, a Jacobian costs as much as a dozen densities and changes little from step to step; a gradient costs two.
The gradient is therefore exact at every step, and only the curvature is corrected. A climb may start from the Jacobian of a similar model.
It ends with an exact one, so that the curvature at the maximum and the test of convergence are those of `levenberg_marquardt`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.inference.bounds import Inside
from estimator.inference.levenberg_marquardt import (
    LARGEST_DAMPING,
    LEAST_SHRINK,
    NEARLY_UNDAMPED,
    SMALLEST_DAMPING,
    STALLED_AFTER,
    STALLED_BELOW,
    Optimum,
    gradient_and_information,
    levenberg_marquardt,
    prior_gradient_and_precision,
)
from estimator.inference.likelihood import FirstOrder, LogPosterior
from estimator.inference.positive_definite import diagonal_of, solve
from estimator.rig.coordinates import Coordinates

MANY_DIRECTIONS = 24  # of derivatives, from which on a Jacobian costs much more than a gradient
MOST_REFUSED = 2  # steps in turn, after which a corrected Jacobian is made anew


def is_worthwhile(posterior: LogPosterior, start: Float[Tensor, "start coordinate"]) -> bool:
    """Whether a Jacobian costs so much that a climb from these starts is shorter with secants."""
    return len(start) == 1 and posterior.n_directions >= MANY_DIRECTIONS


def climb_with_secants(
    posterior: LogPosterior,
    start: Float[Tensor, "1 coordinate"],
    tolerance: float,
    slopes: FirstOrder | None = None,
    max_iterations: int = 60,
    ends_exact: bool = True,
) -> Optimum:
    """Climb to the nearest maximum of the posterior, as `levenberg_marquardt` does from one start.

    The Jacobians of predictions and noise are corrected by Broyden's rank-one update, the least change in units of the posterior's
    curvature. They are made anew where steps are refused all the same, and before the climb ends.

    Args:
        posterior: Density to maximise.
        start: Coordinates to start from, inside the prior.
        tolerance: Stop where a Newton step would increase the log density by less than this.
        slopes: Derivatives at the start, which may be those of a similar model; exact ones by default.
        max_iterations: Largest number of steps.
        ends_exact: Make the Jacobian anew before the climb ends.
    Returns: The maximum with its curvature and slopes, which are exact unless the climb ends otherwise.
    References: Madsen, Nielsen and Tingleff, Methods for Non-Linear Least Squares Problems, 2nd ed. (2004), section 3.5; Broyden,
        Math. Comput. 19, 577 (1965).
    """
    at = _Point.of(posterior, start)
    if at.is_outside:  # there is nothing to correct by
        return levenberg_marquardt(posterior, start, max_iterations, tolerance)
    gradient = at.gradient()
    is_exact = slopes is None
    slopes = posterior.to_first_order(start) if slopes is None else slopes
    model = _Model.about(posterior, at, slopes)
    damping, growth, n_refused, iteration = 1e-3, 2.0, 0, 0
    is_at_bound = False  # the density rises beyond a bound, but no step inside increases it
    is_stalled, before, at_stall = False, [at.value], -math.inf
    while True:
        newton = at.inside.step_of_the_free(model.precision[0], gradient[0])
        promised = float(gradient[0] @ newton)
        is_done = is_at_bound or is_stalled or promised < tolerance or damping > LARGEST_DAMPING
        if (is_exact or not ends_exact) and (is_done or iteration == max_iterations):
            break
        if is_done or iteration == max_iterations or n_refused == MOST_REFUSED:
            model, is_exact = _Model.about(posterior, at, posterior.to_first_order(at.vector)), True
            n_refused, is_at_bound = 0, False
            if is_stalled:
                is_stalled = at.value - at_stall < STALLED_BELOW * tolerance
                before, at_stall = [at.value], at.value
            continue
        iteration += 1
        scale = diagonal_of(model.precision)
        damped = model.precision + damping * torch.diag_embed(scale)
        step, there, is_bounded = _trial(posterior, at, gradient, damped)
        expected = 0.5 * float(((damping * scale * step + gradient) * step).sum())
        is_at_bound = is_bounded and expected < tolerance and damping < NEARLY_UNDAMPED
        if is_at_bound:
            continue
        ratio = (there.value - at.value) / max(expected, 1e-300)
        first_order = (
            model.first_order if there.is_outside else _corrected(model.first_order, at, there, scale)
        )
        if there.value > at.value:
            shrink = min(max(1.0 - (2.0 * ratio - 1.0) ** 3, LEAST_SHRINK), 2.0)
            damping, growth, n_refused = max(damping * shrink, SMALLEST_DAMPING), 2.0, 0
            at, gradient = there, there.gradient()
        else:
            damping, growth = damping * growth, growth * 2.0
            n_refused += not is_exact
        if not (is_exact and at is not there):
            model, is_exact = model.moved(posterior, at, first_order), False
        before.append(at.value)
        is_stalled = (
            len(before) > STALLED_AFTER and at.value - before[-1 - STALLED_AFTER] < STALLED_BELOW * tolerance
        )
    is_converged = is_at_bound or promised < max(tolerance, 1e-6)
    return Optimum(
        at.vector,
        posterior(at.vector),
        model.precision,
        model.information,
        torch.tensor([is_converged], device=at.vector.device),
        iteration,
        model.first_order,
    )


class _Point:
    """A point of a climb: the log posterior density there with the graph of its gradient, predictions and noise.

    Attributes:
        vector: Coordinates, one row.
        inside: The same, for steps inside the bounds of the prior.
        value: Log posterior density.
        is_outside: Whether the prior excludes it, or the model has no value there: then nothing is predicted.
        predicted_T, sigma_T: Predictions and noise.
    """

    def __init__(
        self,
        coordinates: Coordinates,
        vector: Tensor,
        log_density: Tensor,
        predicted_T: Tensor,
        sigma_T: Tensor,
    ) -> None:
        self._log_density, self._free = log_density, vector
        self.vector, self.predicted_T, self.sigma_T = vector.detach(), predicted_T.detach(), sigma_T.detach()
        self.inside = Inside(coordinates, self.vector[0])
        value = float(log_density.detach())
        self.is_outside = not math.isfinite(value)
        self.value = -math.inf if self.is_outside else value

    @classmethod
    def of(cls, posterior: LogPosterior, vector: Tensor) -> _Point:
        """The density at a vector."""
        coordinates, nothing = posterior.coordinates, vector.new_empty(0)
        free = vector.detach().requires_grad_()
        with torch.enable_grad():
            log_prior = coordinates.log_prior(free)
            if not math.isfinite(float(log_prior.detach())):
                return cls(coordinates, free, log_prior, nothing, nothing)
            cheap = posterior.for_jacobian
            predicted_T, sigma_T = cheap.predicted(free), cheap.component_sigma_T(free)
            log_density = log_prior + cheap.log_likelihood_of(predicted_T, sigma_T, free)
        return cls(coordinates, free, log_density, predicted_T, sigma_T)

    def gradient(self) -> Tensor:
        """Exact gradient of the density. Its graph is used up."""
        (gradient,) = torch.autograd.grad(self._log_density.sum(), self._free)
        del self._log_density
        return gradient


@dataclass(frozen=True)
class _Model:
    """Curvature of the density about a point.

    Attributes:
        first_order: Predictions and noise with their derivatives, exact or corrected.
        information, precision: By these.
        prior_precision: The prior's part, where derivatives were last exact.
    """

    first_order: FirstOrder
    information: Tensor
    prior_precision: Tensor

    @classmethod
    def about(cls, posterior: LogPosterior, at: _Point, slopes: FirstOrder) -> _Model:
        """The model with given derivatives."""
        first_order = slopes._replace(predicted_T=at.predicted_T, sigma_T=at.sigma_T)
        _, information = gradient_and_information(posterior, at.vector, first_order)
        _, prior_precision = prior_gradient_and_precision(posterior.coordinates, at.vector)
        return cls(first_order, information, prior_precision)

    def moved(self, posterior: LogPosterior, at: _Point, first_order: FirstOrder) -> _Model:
        """The model with corrected derivatives, elsewhere."""
        first_order = first_order._replace(predicted_T=at.predicted_T, sigma_T=at.sigma_T)
        _, information = gradient_and_information(posterior, at.vector, first_order)
        return _Model(first_order, information, self.prior_precision)

    @property
    def precision(self) -> Tensor:
        return self.information + self.prior_precision


def _corrected(slopes: FirstOrder, before: _Point, after: _Point, scale: Tensor) -> FirstOrder:
    """Derivatives corrected along a step, so that they foretell what it did.

    Args:
        slopes: Before.
        before, after: Its ends.
        scale: Squares of the units in which the change of the derivatives is the least.
    """
    step = (after.vector - before.vector)[:, : scale.shape[-1]]
    along = scale * step / (scale * step.square()).sum()

    def corrected(jacobian: Tensor, change: Tensor) -> Tensor:
        missed = change - (jacobian @ step[..., None])[..., 0]
        return jacobian + missed[..., None] * along[:, None, :]

    return slopes._replace(
        jacobian_T=corrected(slopes.jacobian_T, after.predicted_T - before.predicted_T),
        log_sigma_jacobian=corrected(slopes.log_sigma_jacobian, torch.log(after.sigma_T / before.sigma_T)),
    )


def _trial(
    posterior: LogPosterior, at: _Point, gradient: Tensor, damped: Tensor
) -> tuple[Tensor, _Point, bool]:
    """Damped step, the point that it leads to, and whether bounds changed it."""

    def after(step: Tensor) -> _Point:
        vector = at.vector.clone()
        vector[:, : step.shape[-1]] += step
        return _Point.of(posterior, vector)

    step = solve(damped, gradient)
    there = after(step)
    is_bounded = there.is_outside
    if is_bounded:
        step = at.inside.along_bounds(damped[0], step[0])[None]
        there = after(step)
    return step, there, is_bounded
