"""Levenberg-Marquardt maximisation of the posterior, with exact Jacobians, from many starts at once."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from estimator.inference.bounds import Inside
from estimator.inference.likelihood import DERIVATIVES_AT_ONCE, FirstOrder, LogPosterior
from estimator.inference.positive_definite import diagonal_of, inner_products, solve
from estimator.rig.coordinates import Coordinates

SMALLEST_DAMPING, LARGEST_DAMPING = 1e-12, 1e12
NEARLY_UNDAMPED = 1e-2
# Iterations in which a start that still climbs is expected to rise by more than 50 times the tolerance.
STALLED_AFTER = 8
STALLED_BELOW = 50.0
LEAST_SHRINK = 0.1  # of the damping after a step that the quadratic model foretold; Nielsen's third costs three iterations more
BEHIND = 5.0  # times the rise that a Newton step promises: a start that lies so far below another climbs a lower maximum
SAME_SD = 1.0  # between the ends of two Newton steps: they lead to the same maximum
LEAST_CURVATURE = 0.1  # of the prior in its own units; flat priors have none, and undetermined directions would have no width


@dataclass(frozen=True)
class Optimum:
    """Maxima that Levenberg-Marquardt reached, one for each start.

    Attributes:
        vector: Coordinates of the maxima.
        log_posterior: Log posterior density there.
        precision: Negative Hessian of the log posterior: Gauss-Newton for the data, exact for a prior that is not flat.
        information: The data's part of it (Fisher information).
        is_converged: The predicted increase by a further step inside the prior is below the tolerance.
        slopes: Predictions and noise to first order at the maximum, where the climb keeps them.
    """

    vector: Float[Tensor, "start coordinate"]
    log_posterior: Float[Tensor, " start"]
    precision: Float[Tensor, "start continuous continuous"]
    information: Float[Tensor, "start continuous continuous"]
    is_converged: Bool[Tensor, " start"]
    n_iterations: int
    slopes: FirstOrder | None = None

    @property
    def tensors(self) -> tuple[Tensor, ...]:
        """All that has a row for each start."""
        return self.vector, self.log_posterior, self.precision, self.information, self.is_converged

    @staticmethod
    def _of(tensors: Iterable[Tensor], n_iterations: int) -> Optimum:
        vector, log_posterior, precision, information, is_converged = tensors
        return Optimum(vector, log_posterior, precision, information, is_converged, n_iterations)

    def rows(self, index: slice | Tensor) -> Optimum:
        """Select starts; slopes are left out."""
        return self._of((tensor[index] for tensor in self.tensors), self.n_iterations)

    def highest(self) -> Optimum:
        """The start that reached the highest maximum, with the slopes of a climb that had no other."""
        top = int(self.log_posterior.argmax())
        return replace(self.rows(slice(top, top + 1)), slopes=self.slopes)

    def at(self, vector: Float[Tensor, " coordinate"]) -> Optimum:
        """The curvature of this maximum at other coordinates."""
        return replace(self, vector=vector[None], slopes=None)

    def to(self, device: torch.device) -> Optimum:
        """These maxima on another device, without slopes."""
        return self._of((tensor.to(device) for tensor in self.tensors), self.n_iterations)

    @staticmethod
    def concatenated(fits: list[Optimum]) -> Optimum:
        """Join several fits along the axis of starts."""
        joined = (torch.cat(tensors) for tensors in zip(*(fit.tensors for fit in fits), strict=True))
        return Optimum._of(joined, max(fit.n_iterations for fit in fits))


def levenberg_marquardt(
    posterior: LogPosterior,
    start: Float[Tensor, "start coordinate"],
    max_iterations: int = 60,
    tolerance: float = 1e-10,
    is_race: bool = False,
) -> Optimum:
    """Climb to the nearest maximum of the posterior from every start.

    A start that crawls along a curved valley ends before it converges: where a few iterations no longer lift it by what counts.

    The noise is a coordinate like the others. Its score and information follow from the whitened residuals; the off-diagonal terms with
    other coordinates are zero in expectation. Whole-numbered counts, the last columns of an integer lattice, stay fixed.

    Args:
        posterior: Density to maximise.
        start: Coordinates to start from, inside the prior.
        max_iterations: Largest number of iterations.
        tolerance: Stop where a Newton step would increase the log density by less than this.
        is_race: Whether only the highest maximum counts: a start ends too where another one goes to the same maximum, or to a higher one.
    Returns: The maxima with their curvature, start by start.
    References: Marquardt, J. SIAM 11, 431 (1963); Nielsen, IMM-REP-1999-05 for the damping.
    """
    vector = start.clone()
    value = posterior(vector)
    damping = vector.new_full((len(vector),), 1e-3)
    growth = torch.full_like(damping, 2.0)
    gradient, information, precision = _gradient_and_precision(posterior, vector)
    is_done = torch.zeros_like(damping, dtype=torch.bool)
    at_bound = torch.zeros_like(is_done)  # the density rises beyond a bound, but no step inside increases it
    before = [value.clone()]
    iteration = 0
    for iteration in range(1, max_iterations + 1):  # noqa: B007 (told at the end)
        newton = solve(precision, gradient)
        promised = 0.5 * (gradient * newton).sum(-1)
        is_done = is_done | (2.0 * promised < tolerance) | at_bound | (damping > LARGEST_DAMPING)
        if len(before) > STALLED_AFTER:
            rise = value - before.pop(0)
            is_done |= rise < STALLED_BELOW * tolerance
        if is_race:
            is_done |= _is_beaten(value, promised, vector[:, : newton.shape[-1]] + newton, precision)
        active = (~is_done).nonzero().flatten()
        if not len(active):
            break
        damped = precision[active] + damping[active, None, None] * _diagonal(precision[active])
        step, trial, trial_value, is_bounded = _trial(
            posterior.at(active), vector[active], damped, gradient[active]
        )
        expected = 0.5 * (
            (damping[active, None] * diagonal_of(precision[active]) * step + gradient[active]) * step
        ).sum(-1)
        ratio = (trial_value - value[active]) / expected.clamp(min=1e-300)
        is_better = trial_value > value[active]
        shrink = (1.0 - (2.0 * ratio - 1.0) ** 3).clamp(min=LEAST_SHRINK, max=2.0)
        damping[active] = torch.where(is_better, damping[active] * shrink, damping[active] * growth[active])
        growth[active] = torch.where(is_better, torch.full_like(ratio, 2.0), growth[active] * 2.0)
        damping.clamp_(min=SMALLEST_DAMPING)
        moved = active[is_better]
        if len(moved):
            vector[moved] = trial[is_better]
            value[moved] = trial_value[is_better]
            gradient[moved], information[moved], precision[moved] = _gradient_and_precision(
                posterior.at(moved), vector[moved]
            )
        before.append(value.clone())
        at_bound[active] = (
            is_bounded & is_better & (expected < tolerance) & (damping[active] < NEARLY_UNDAMPED)
        )
    newton = solve(precision, gradient)
    is_converged = at_bound | ((gradient * newton).sum(-1) < max(tolerance, 1e-6))
    return Optimum(vector, value, precision, information, is_converged, iteration)


def _is_beaten(value: Tensor, promised: Tensor, ahead: Tensor, precision: Tensor) -> Tensor:
    """Starts that a higher maximum makes superfluous, given the rise that a Newton step promises each and where it leads."""
    top = int(value.argmax())
    apart = ahead - ahead[top]
    joins = ((apart @ precision[top]) * apart).sum(-1) < SAME_SD**2
    joins[top] = False
    return joins | (value + BEHIND * promised < value[top])


def _trial(
    posterior: LogPosterior, vector: Tensor, damped: Tensor, gradient: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Damped step of every start, the point it leads to, the density there, and whether bounds changed the step."""
    n = posterior.coordinates.n_continuous
    step = solve(damped, gradient)
    trial = vector.clone()
    trial[:, :n] += step
    trial_value = posterior(trial)
    is_bounded = torch.isinf(trial_value)
    for i in is_bounded.nonzero().flatten():
        step[i] = Inside(posterior.coordinates, vector[i]).along_bounds(damped[i], step[i])
        trial[i, :n] = vector[i, :n] + step[i]
        trial_value[i] = posterior.at(i)(trial[i])
    return step, trial, trial_value, is_bounded


def _gradient_and_precision(
    posterior: LogPosterior, vector: Float[Tensor, "start coordinate"]
) -> tuple[Tensor, Tensor, Tensor]:
    """Gradient of the log posterior, the data's part of its negative Hessian, and the whole of it; some starts at a time."""
    at_once = max(
        1, DERIVATIVES_AT_ONCE // max(1, len(posterior.sensor) * posterior.coordinates.n_continuous)
    )
    if len(vector) > at_once:
        parts = torch.arange(len(vector), device=vector.device).split(at_once)
        each = [_gradient_and_precision(posterior.at(part), vector[part]) for part in parts]
        gradient, information, precision = (torch.cat(tensors) for tensors in zip(*each, strict=True))
        return gradient, information, precision
    gradient, information = gradient_and_information(posterior, vector, posterior.to_first_order(vector))
    prior_gradient, prior_precision = prior_gradient_and_precision(posterior.coordinates, vector)
    return gradient + prior_gradient, information, information + prior_precision


def gradient_and_information(
    posterior: LogPosterior, vector: Float[Tensor, "start coordinate"], first_order: FirstOrder
) -> tuple[Float[Tensor, "start continuous"], Float[Tensor, "start continuous continuous"]]:
    """Gradient of the log likelihood, and its Fisher information, given predictions and noise to first order."""
    predicted_T, sigma_T, jacobian_T, log_sigma_jacobian = first_order
    whitened = (posterior.measured_T - predicted_T) / sigma_T
    weight = posterior.weight(whitened, vector)
    jacobian = jacobian_T / sigma_T[..., None]
    chi2 = weight * whitened**2
    gradient = (jacobian.mT @ (weight * whitened)[..., None])[..., 0]
    information = inner_products(weight.sqrt()[..., None] * jacobian)
    by_sensor = chi2.new_zeros(len(vector), len(posterior.n_by_sensor))
    by_sensor.index_add_(1, posterior.sensor, chi2)
    mean_chi2 = (by_sensor / posterior.n_by_sensor.clamp(min=1.0))[:, posterior.sensor]
    curvature = (2.0 * mean_chi2).clamp(min=0.5)
    noises = log_sigma_jacobian.any(-2).any(0).nonzero().flatten()  # few columns change the noise
    slopes = log_sigma_jacobian[..., noises]
    gradient[..., noises] += (slopes.mT @ (chi2 - 1.0)[..., None])[..., 0]
    information[..., noises[:, None], noises] += inner_products(curvature.sqrt()[..., None] * slopes)
    return gradient, information


def prior_gradient_and_precision(
    coordinates: Coordinates, vector: Float[Tensor, "start coordinate"]
) -> tuple[Float[Tensor, "start continuous"], Float[Tensor, "start continuous continuous"]]:
    """Gradient of the log prior, and its negative Hessian with curvatures raised to at least `LEAST_CURVATURE`.

    Coordinates that the prior does not couple share one direction of the second pass.
    """
    n, coupled = coordinates.n_continuous, coordinates.coupled
    apart = torch.ones(n, dtype=torch.bool, device=vector.device)
    apart[coupled] = False
    each = torch.eye(coordinates.n, dtype=vector.dtype, device=vector.device)[:n]
    directions = torch.cat((each[coupled], each[apart].sum(0, keepdim=True)))[:, None].expand(
        -1, len(vector), -1
    )
    point = vector.detach().requires_grad_()
    with torch.enable_grad():
        # Starts are independent: the gradient of the sum holds that of each. The second term gives flat priors a (zero) gradient.
        total = coordinates.log_prior(point).sum() + 0.0 * point.square().sum()
        (gradient,) = torch.autograd.grad(total, point, create_graph=True)
        (hessian_rows,) = torch.autograd.grad(gradient, point, directions, is_grads_batched=True)
    scale = coordinates.scale[:n]
    least = LEAST_CURVATURE / scale**2
    precision = torch.diag_embed(torch.maximum(-hessian_rows[-1, :, :n], least))
    if len(coupled):
        curvature = -hessian_rows[:-1, :, coupled].transpose(0, 1)
        unit = scale[coupled, None] * scale[coupled]
        eigenvalues, vectors = torch.linalg.eigh(0.5 * (curvature + curvature.mT) * unit)
        block = vectors @ (eigenvalues.clamp(min=LEAST_CURVATURE)[..., None] * vectors.mT) / unit
        precision[:, coupled[:, None], coupled] = block
    return gradient[:, :n].detach(), precision


def prior_gradient(
    coordinates: Coordinates, vector: Float[Tensor, " coordinate"]
) -> Float[Tensor, " coordinate"]:
    """Gradient of the log prior alone, which takes a fifth of the time."""
    point = vector.detach().requires_grad_()
    with torch.enable_grad():
        # The second term gives flat priors a (zero) gradient.
        total = coordinates.log_prior(point) + 0.0 * point.square().sum()
        gradient: Tensor = torch.autograd.grad(total, point)[0]
    return gradient


def _diagonal(matrix: Tensor) -> Tensor:
    return torch.diag_embed(diagonal_of(matrix))
