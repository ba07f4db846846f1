"""Levenberg-Marquardt with exact Jacobians, many starts at once."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.func import jacfwd

from estimator.inference.likelihood import LogPosterior
from estimator.rig.coordinates import Coordinates

SMALLEST_DAMPING, LARGEST_DAMPING = 1e-12, 1e12
NEARLY_UNDAMPED = 1e-2
APPROACH = 0.9  # of the way to a bound in one step
MOST_CORRECTIONS = 5
LEAST_CURVATURE = 0.1  # of the prior in its own units; flat priors have none, and what the data leave open would have no width


@dataclass(frozen=True)
class Optimum:
    """Where Levenberg-Marquardt stopped.

    Attributes:
        vector: Coordinates of the maxima.
        log_posterior: Log posterior density there.
        precision: Negative Hessian of the log posterior, Gauss-Newton for the data, exact for a prior that is not flat.
        information: The data's share of it (Fisher information).
        is_converged: The predicted gain of a further step inside the prior is below the tolerance.
    """

    vector: Float[Tensor, "start coordinate"]
    log_posterior: Float[Tensor, " start"]
    precision: Float[Tensor, "start continuous continuous"]
    information: Float[Tensor, "start continuous continuous"]
    is_converged: Bool[Tensor, " start"]
    n_iterations: int

    def rows(self, index: slice | Tensor) -> Optimum:
        """The chosen starts only."""
        return Optimum(
            self.vector[index],
            self.log_posterior[index],
            self.precision[index],
            self.information[index],
            self.is_converged[index],
            self.n_iterations,
        )

    @staticmethod
    def together(fits: list[Optimum]) -> Optimum:
        """Several fits as one."""
        return Optimum(
            torch.cat([fit.vector for fit in fits]),
            torch.cat([fit.log_posterior for fit in fits]),
            torch.cat([fit.precision for fit in fits]),
            torch.cat([fit.information for fit in fits]),
            torch.cat([fit.is_converged for fit in fits]),
            max(fit.n_iterations for fit in fits),
        )


def levenberg_marquardt(
    posterior: LogPosterior,
    start: Float[Tensor, "start coordinate"],
    max_iterations: int = 60,
    tolerance: float = 1e-10,
) -> Optimum:
    """Climb to the nearest maximum of the posterior from every start.

    The noise is a coordinate like the others: its score and information follow from the whitened residuals, and its off-diagonal terms
    with the other coordinates are zero in expectation. Whole-numbered counts, the last columns of an integer lattice, stay where they are.

    Args:
        posterior: Density to climb.
        start: Coordinates to start from, inside the prior.
        max_iterations: Bound on the number of steps.
        tolerance: Stop where a Newton step would gain less log density than this.
    Returns: The maxima with their curvature, start by start.
    References: Marquardt, J. SIAM 11, 431 (1963); Nielsen, IMM-REP-1999-05 for the damping.
    """
    n = posterior.coordinates.n_continuous
    vector = start.clone()
    value = posterior(vector)
    damping = torch.full((len(vector),), 1e-3, dtype=vector.dtype)
    growth = torch.full_like(damping, 2.0)
    gradient, information, precision = _slope(posterior, vector)
    done = torch.zeros(len(vector), dtype=torch.bool)
    # There the density still rises, but no step that stays inside gains by it.
    at_bound = torch.zeros_like(done)
    iteration = 0
    for iteration in range(1, max_iterations + 1):  # noqa: B007 - reported
        newton = solve(precision, gradient)
        done = done | ((gradient * newton).sum(-1) < tolerance) | at_bound | (damping > LARGEST_DAMPING)
        active = (~done).nonzero().flatten()
        if not len(active):
            break
        damped = precision[active] + damping[active, None, None] * _diagonal(precision[active])
        step = solve(damped, gradient[active])
        trial = vector[active].clone()
        trial[:, :n] += step
        trial_value = posterior.at(active)(trial)
        is_bounded = torch.isinf(trial_value)
        for i in is_bounded.nonzero().flatten().tolist():
            step[i] = _along_bounds(posterior, vector[active[i]], damped[i], step[i])
            trial[i, :n] = vector[active[i], :n] + step[i]
            trial_value[i] = posterior.at(active[i])(trial[i])
        expected = 0.5 * (
            (damping[active, None] * _diagonal_of(precision[active]) * step + gradient[active]) * step
        ).sum(-1)
        ratio = (trial_value - value[active]) / expected.clamp(min=1e-300)
        better = trial_value > value[active]
        shrink = (1.0 - (2.0 * ratio - 1.0) ** 3).clamp(min=1.0 / 3.0, max=2.0)
        damping[active] = torch.where(better, damping[active] * shrink, damping[active] * growth[active])
        growth[active] = torch.where(better, torch.full_like(ratio, 2.0), growth[active] * 2.0)
        damping.clamp_(min=SMALLEST_DAMPING)
        moved = active[better]
        if len(moved):
            vector[moved] = trial[better]
            value[moved] = trial_value[better]
            gradient[moved], information[moved], precision[moved] = _slope(posterior.at(moved), vector[moved])
        at_bound[active] = is_bounded & better & (expected < tolerance) & (damping[active] < NEARLY_UNDAMPED)
    newton = solve(precision, gradient)
    is_converged = at_bound | ((gradient * newton).sum(-1) < max(tolerance, 1e-6))
    return Optimum(vector, value, precision, information, is_converged, iteration)


def _slope(
    posterior: LogPosterior, vector: Float[Tensor, "start coordinate"]
) -> tuple[Tensor, Tensor, Tensor]:
    """Gradient of the log posterior, the data's share of its negative Hessian, and all of that."""
    sigma_T = posterior.component_sigma_T(vector)
    whitened = (posterior.measured_T - posterior.predicted(vector)) / sigma_T
    weight = posterior.weight(whitened, vector)
    jacobian = posterior.slope(vector) / sigma_T[..., None]
    log_sigma_jacobian = posterior.log_sigma_slope(vector)
    chi2 = weight * whitened**2
    gradient = (jacobian.mT @ (weight * whitened)[..., None])[..., 0]
    gradient = gradient + (log_sigma_jacobian.mT @ (chi2 - 1.0)[..., None])[..., 0]
    information = jacobian.mT @ (weight[..., None] * jacobian)
    by_sensor = torch.zeros(len(vector), len(posterior.n_by_sensor), dtype=vector.dtype)
    by_sensor.index_add_(1, posterior.sensor, chi2)
    mean_chi2 = (by_sensor / posterior.n_by_sensor.clamp(min=1.0))[:, posterior.sensor]
    curvature = torch.maximum(2.0 * mean_chi2, torch.tensor(0.5, dtype=vector.dtype))[..., None]
    information = information + log_sigma_jacobian.mT @ (curvature * log_sigma_jacobian)
    prior_gradient, prior_precision = prior_slope(posterior.coordinates, vector)
    return gradient + prior_gradient, information, information + prior_precision


def prior_slope(
    coordinates: Coordinates, vector: Float[Tensor, "start coordinate"]
) -> tuple[Float[Tensor, "start continuous"], Float[Tensor, "start continuous continuous"]]:
    """Gradient of the log prior, and its negative Hessian with some curvature where it has none."""
    n = coordinates.n_continuous
    at = vector.detach().requires_grad_()
    every = torch.eye(coordinates.n, dtype=vector.dtype)[:n, None, :].expand(-1, len(vector), -1)
    with torch.enable_grad():
        # The density of a start depends on no other start: the gradient of their sum is that of each. Flat priors depend on nothing.
        total = coordinates.log_prior(at).sum() + 0.0 * at.square().sum()
        (gradient,) = torch.autograd.grad(total, at, create_graph=True)
        (rows,) = torch.autograd.grad(gradient, at, every, is_grads_batched=True)
    own = -rows[..., :n].transpose(0, 1)
    scale = coordinates.scale[:n]
    unit = scale[:, None] * scale[None, :]
    eigenvalues, vectors = torch.linalg.eigh(0.5 * (own + own.mT) * unit)
    precision: Tensor = vectors @ (eigenvalues.clamp(min=LEAST_CURVATURE)[..., None] * vectors.mT) / unit
    return gradient[:, :n].detach(), precision


def _along_bounds(posterior: LogPosterior, vector: Tensor, damped: Tensor, step: Tensor) -> Tensor:
    """The best damped step that stays inside the prior: bounds it would overstep are approached, and it slides along them.

    References: Nocedal and Wright, Numerical Optimization, 2nd ed., section 16.1 (equality-constrained quadratic programs).
    """
    coordinates = posterior.coordinates
    n = coordinates.n_continuous

    def free_values(continuous: Tensor) -> Tensor:
        values = coordinates.values(torch.cat((continuous, vector[n:])))
        return torch.stack([values[name] for name in coordinates.names])

    lower, upper = coordinates.bounds()
    here, slope = free_values(vector[:n]), jacfwd(free_values)(vector[:n])
    is_held, target = torch.zeros(coordinates.n, dtype=torch.bool), here.clone()
    best = step
    # Bounds are curved in these coordinates: what the first order leaves outside is corrected by the values themselves.
    to_first_order = (lambda move: here + slope @ move, coordinates.n)
    really = (lambda move: free_values(vector[:n] + move), MOST_CORRECTIONS)
    for values_after, rounds in (to_first_order, really):
        for _ in range(rounds):
            there = values_after(best)
            over = (there < lower) | (there > upper)
            if not over.any():
                break
            ahead = here + APPROACH * (torch.where(there < lower, lower, upper) - here)
            target = torch.where(over & ~is_held, ahead, target)
            is_held |= over
            normal = slope[is_held]
            across = torch.stack([solve(damped, row) for row in normal], dim=-1)
            miss = (there - target)[is_held]
            best = best - across @ torch.linalg.lstsq(normal @ across, miss[:, None]).solution[:, 0]
    return best


def solve(matrix: Tensor, right: Tensor) -> Tensor:
    """Solution of a positive definite system, scaled to a unit diagonal first: coordinates differ in size by many powers of ten."""
    scale = _diagonal_of(matrix).clamp(min=1e-300).rsqrt()
    scaled = matrix * scale[..., :, None] * scale[..., None, :] + 1e-14 * torch.eye(
        matrix.shape[-1], dtype=matrix.dtype
    )
    solution: Tensor = torch.linalg.solve(scaled, scale * right)
    return scale * solution


def _diagonal_of(matrix: Tensor) -> Tensor:
    return torch.diagonal(matrix, dim1=-2, dim2=-1)


def _diagonal(matrix: Tensor) -> Tensor:
    return torch.diag_embed(_diagonal_of(matrix))
