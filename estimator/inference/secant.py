"""Levenberg-Marquardt with secants: between exact Jacobians, each step corrects the last one by what it has shown.

Where many numbers are free, a Jacobian costs as much as dozens of densities, and changes little from step to step. A climb may start from the
Jacobian of a similar model; it ends with an exact one, so that its curvature and the test of its convergence are those of exact steps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.inference.levenberg_marquardt import (
    LARGEST_DAMPING,
    LEAST_SHRINK,
    NEARLY_UNDAMPED,
    SMALLEST_DAMPING,
    STALLED_AFTER,
    STALLED_BELOW,
    Optimum,
    along_bounds,
    diagonal_of,
    gradient_and_information,
    prior_gradient,
    prior_gradient_and_precision,
    solve,
)
from estimator.inference.likelihood import FirstOrder, LogPosterior

MANY_DIRECTIONS = 24  # of derivatives, from which on a Jacobian costs much more than a density
LEAST_FORETOLD = 0.25  # of the rise that the model promised: below, its Jacobian is made anew
MOST_SECANTS = 8  # steps between two exact Jacobians


def is_worthwhile(posterior: LogPosterior, start: Float[Tensor, "start coordinate"]) -> bool:
    """Whether a Jacobian costs so much that a climb from these starts is shorter with secants."""
    return len(start) == 1 and posterior.n_directions >= MANY_DIRECTIONS


def climb_with_secants(
    posterior: LogPosterior,
    start: Float[Tensor, "1 coordinate"],
    tolerance: float,
    slopes: FirstOrder | None = None,
    max_iterations: int = 60,
) -> tuple[Optimum, FirstOrder]:
    """Climb to the nearest maximum of the posterior, as `levenberg_marquardt` does from one start.

    The Jacobians of predictions and noise are corrected by Broyden's rank-one update, the least change in units of the posterior's
    curvature. They are made anew where a step is refused, or rises by much less than foretold, and before the climb ends.

    Args:
        posterior: Density to maximise.
        start: Coordinates to start from, inside the prior.
        tolerance: Stop where a Newton step would increase the log density by less than this.
        slopes: Predictions and noise at the start, with derivatives that may be those of a similar model; exact ones by default.
        max_iterations: Largest number of steps.
    Returns: The maximum with its curvature, and predictions and noise there to first order, both exact.
    References: Madsen, Nielsen and Tingleff, Methods for Non-Linear Least Squares Problems, 2nd ed. (2004), section 3.5; Broyden,
        Math. Comput. 19, 577 (1965).
    """
    at = _Point.exact(posterior, start) if slopes is None else _Point.near(posterior, start, slopes)
    damping, growth, n_secants = 1e-3, 2.0, 0
    is_at_bound = False  # the density rises beyond a bound, but no step inside increases it
    is_stalled, before, at_stall = False, [at.value], -math.inf
    iteration = 0
    while True:
        newton = solve(at.precision, at.gradient)
        promised = float((at.gradient * newton).sum())
        is_done = is_at_bound or is_stalled or promised < tolerance or damping > LARGEST_DAMPING
        if at.is_exact and (is_done or iteration == max_iterations):
            break
        if is_done or iteration == max_iterations or n_secants == MOST_SECANTS:
            at, n_secants, is_at_bound = _Point.exact(posterior, at.vector), 0, False
            if is_stalled:
                is_stalled = at.value - at_stall < STALLED_BELOW * tolerance
                before, at_stall = [at.value], at.value
            continue
        iteration += 1
        scale = diagonal_of(at.precision)
        damped = at.precision + damping * torch.diag_embed(scale)
        step, there, is_bounded = _trial(posterior, at, damped)
        expected = 0.5 * float(((damping * scale * step + at.gradient) * step).sum())
        is_at_bound = is_bounded and expected < tolerance and damping < NEARLY_UNDAMPED
        if is_at_bound:
            continue
        ratio = (there.value - at.value) / max(expected, 1e-300)
        if there.value > at.value:
            shrink = min(max(1.0 - (2.0 * ratio - 1.0) ** 3, LEAST_SHRINK), 2.0)
            damping, growth = max(damping * shrink, SMALLEST_DAMPING), 2.0
            if ratio < LEAST_FORETOLD and not at.is_exact:
                at, n_secants = _Point.exact(posterior, there.vector), 0
            else:
                at, n_secants = there.by_secant(posterior, at, step, scale), n_secants + 1
        elif at.is_exact:
            damping, growth = damping * growth, growth * 2.0
        else:
            at, n_secants = _Point.exact(posterior, at.vector), 0
        before.append(at.value)
        is_stalled = len(before) > STALLED_AFTER and at.value - before[-1 - STALLED_AFTER] < STALLED_BELOW * tolerance
    is_converged = is_at_bound or promised < max(tolerance, 1e-6)
    optimum = Optimum(
        at.vector,
        at.vector.new_tensor([at.value]),
        at.precision,
        at.information,
        torch.tensor([is_converged], device=at.vector.device),
        iteration,
    )
    return optimum, at.first_order


@dataclass(frozen=True)
class _Point:
    """Where a climb has come to, with the model of the density about it.

    Attributes:
        vector: Coordinates, one row.
        value: Log posterior density.
        first_order: Predictions and noise, exact, and their derivatives.
        is_exact: Whether the derivatives are exact too.
        gradient, information, precision: Of the density by these.
    """

    vector: Tensor
    value: float
    first_order: FirstOrder
    is_exact: bool = False
    gradient: Tensor = torch.empty(0)
    information: Tensor = torch.empty(0)
    precision: Tensor = torch.empty(0)

    @classmethod
    def exact(cls, posterior: LogPosterior, vector: Tensor) -> _Point:
        """With exact derivatives."""
        return cls._modelled(posterior, vector, posterior.to_first_order(vector), is_exact=True)

    @classmethod
    def near(cls, posterior: LogPosterior, vector: Tensor, slopes: FirstOrder) -> _Point:
        """With derivatives that are given."""
        return cls._modelled(posterior, vector, slopes, is_exact=False)

    @classmethod
    def _modelled(cls, posterior: LogPosterior, vector: Tensor, first_order: FirstOrder, is_exact: bool) -> _Point:
        value = _value(posterior, vector, first_order)
        gradient, information = gradient_and_information(posterior, vector, first_order)
        of_prior, prior_precision = prior_gradient_and_precision(posterior.coordinates, vector)
        return cls(
            vector, value, first_order, is_exact, gradient + of_prior, information, information + prior_precision
        )

    def by_secant(self, posterior: LogPosterior, start: _Point, step: Tensor, scale: Tensor) -> _Point:
        """This point with the derivatives of another one, corrected along the step that led here.

        Args:
            posterior: The density.
            start: The other one.
            step: From there.
            scale: Squares of the units in which the change of the derivatives is the least.
        """
        along = scale * step / (scale * step.square()).sum()
        old, new = start.first_order, self.first_order
        change_T = new.predicted_T - old.predicted_T - _along(old.jacobian_T, step)
        log_change = torch.log(new.sigma_T / old.sigma_T) - _along(old.log_sigma_jacobian, step)
        first_order = FirstOrder(
            new.predicted_T,
            new.sigma_T,
            old.jacobian_T + change_T[..., None] * along[:, None, :],
            old.log_sigma_jacobian + log_change[..., None] * along[:, None, :],
        )
        gradient, information = gradient_and_information(posterior, self.vector, first_order)
        of_prior = prior_gradient(posterior.coordinates, self.vector)
        prior_precision = start.precision - start.information
        return replace(
            self,
            first_order=first_order,
            gradient=gradient + of_prior,
            information=information,
            precision=information + prior_precision,
        )


def _along(jacobian: Tensor, step: Tensor) -> Tensor:
    along: Tensor = (jacobian @ step[..., None])[..., 0]
    return along


def _value(posterior: LogPosterior, vector: Tensor, first_order: FirstOrder) -> float:
    """Log posterior density, given predictions and noise; -inf where it has none."""
    log_prior = posterior.coordinates.log_prior(vector)
    value = float(log_prior + posterior.log_likelihood_of(first_order.predicted_T, first_order.sigma_T, vector))
    return value if math.isfinite(value) else -math.inf


def _trial(posterior: LogPosterior, at: _Point, damped: Tensor) -> tuple[Tensor, _Point, bool]:
    """Damped step, the point it leads to with the old derivatives, and whether bounds changed the step."""
    n = posterior.coordinates.n_continuous
    step = solve(damped, at.gradient)
    there = _reached(posterior, at, step)
    is_bounded = math.isinf(there.value)
    if is_bounded:
        step = along_bounds(posterior, at.vector[0], damped[0], step[0])[None]
        there = _reached(posterior, at, step)
    assert step.shape[-1] == n
    return step, there, is_bounded


def _reached(posterior: LogPosterior, at: _Point, step: Tensor) -> _Point:
    """The point after a step; its density is -inf outside the prior, where nothing is predicted."""
    vector = at.vector.clone()
    vector[:, : step.shape[-1]] += step
    if not math.isfinite(float(posterior.coordinates.log_prior(vector))):
        return replace(at, vector=vector, value=-math.inf, is_exact=False)
    there = at.first_order._replace(
        predicted_T=posterior.predicted(vector), sigma_T=posterior.component_sigma_T(vector)
    )
    return replace(
        at, vector=vector, value=_value(posterior, vector, there), first_order=there, is_exact=False
    )
