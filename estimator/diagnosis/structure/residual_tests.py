"""Tests whether residuals are noise: their size against noise known otherwise, and their structure along covariates.

The covariates are tested together: each p-value is the probability that, in pure noise, at least one of them is as striking.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.special import betaincc, chdtrc, fdtrc, ndtr  # what scipy.stats calls, without its long import
from torch import Tensor

from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.structure.covariates import Covariate, covariates
from estimator.diagnosis.structure.smooth import legendre, unit_interval
from estimator.readings.observations import Observations
from estimator.rig.parameters import LogNormal

# Degrees of freedom from which on repeats say what the noise is: it is known to 22 % then
FEWEST_REPEATS = 10
N_NOISE_DRAWS = 2000  # of pure noise, that tests are compared with: a p-value of 0.05 is known to 10 %
SETTING_DEGREE = 4  # of curves in one circumstance, such as a current or a pause

RANK_TOLERANCE = 1e-6


@dataclass(frozen=True)
class LackOfFit:
    """Size of the residuals against the noise.

    Attributes:
        rms_T: Of the residual components.
        noise_T: Rms expected from noise alone.
        noise_from: `repeats` (readings at one pose and current) or `specification` (the rig file).
        p_value: Probability of residuals at least so large from noise alone.
    """

    rms_T: float
    noise_T: float
    noise_from: str
    p_value: float


@dataclass(frozen=True)
class Structure:
    """Dependence of the residual on one covariate.

    Attributes:
        p_value: Of the most striking component, adjusted for all covariates and components.
        share: Share of the residual's sum of squares that smooth functions of the covariate explain.
        expected_share: Share that they would explain of pure noise.
        by_component: Unadjusted p-value of each component of the reading.
    """

    covariate: Covariate
    p_value: float
    share: float
    expected_share: float
    by_component: tuple[float, float, float]


def lack_of_fit(fit: Fit) -> LackOfFit:
    """Compare the residuals with the noise of repeats or, where a sensor lacks these, with that of the rig file, each sensor by its own."""
    residual_T, sensor = fit.residual / fit.whitening_per_T, fit.posterior.sensor
    rms_T = float(residual_T.square().mean().sqrt())
    repeats = _repeats(fit.observations)
    n, n_fitted = len(residual_T), float(fit.projector.basis.square().sum())  # priors fix the rest
    if repeats is not None and n - n_fitted > (n_free := repeats[1]):
        noise_T = repeats[0][sensor]
        squares = float((residual_T / noise_T).square().sum())
        mean_square = max(squares - n_free, 0.0) / (n - n_fitted - n_free)
        p_value = float(fdtrc(n - n_fitted - n_free, n_free, mean_square))
        return LackOfFit(rms_T, float(noise_T.square().mean().sqrt()), "repeats", p_value)
    expected_T, width = _specified(fit)
    squares = float((residual_T / expected_T[sensor]).square().sum())
    if width == 0.0:
        p_value = float(chdtrc(n - n_fitted, squares))
    else:
        ratio = 0.5 * math.log(squares / n)
        p_value = float(ndtr(-ratio / math.hypot(width, 1.0 / math.sqrt(2.0 * n))))
    return LackOfFit(rms_T, float(expected_T[sensor].square().mean().sqrt()), "specification", p_value)


def structure(fit: Fit, seed: int = 0) -> list[Structure]:
    """Test the residual for structure along every covariate, the most striking first.

    Each component of the reading is regressed on Legendre polynomials of the covariate, less what the fit can follow and less a constant,
    which is tested by itself. Pure noise, put through the same fit, gives the distribution of the smallest p-value of all tests.

    References: Westfall and Young, Resampling-Based Multiple Testing (1993), section 2.3 (unadjusted-step minP); Langsrud, Stat. Comput. 15
        (2005) 53 (rotation tests: exact for normal noise of unknown size).
    """
    constant = Covariate("a constant offset", "1", torch.ones(len(fit.observations), dtype=torch.float64))
    tested = [constant, *covariates(fit)]
    bases = [[_basis(fit, covariate, axis) for axis in range(3)] for covariate in tested]
    bases[1:] = [
        [_without(basis, constant_basis) for basis, constant_basis in zip(by_axis, bases[0], strict=True)]
        for by_axis in bases[1:]
    ]
    generator = torch.Generator().manual_seed(seed)
    # Single precision, for a third of the time: p-values are known to a few per cent.
    noise = torch.randn(len(fit.residual), N_NOISE_DRAWS, generator=generator)
    noise = fit.projector.in_single().rest(noise)
    noise = noise / noise.norm(dim=0)
    direction = fit.residual / fit.residual.norm()
    n_directions = torch.tensor([[columns.shape[1] for columns in basis] for basis in bases])
    share = torch.tensor(
        [[float((columns.T @ direction).square().sum()) for columns in basis] for basis in bases],
        dtype=torch.float64,
    )
    by_width: dict[int, list[Tensor]] = {}
    for columns in (columns for basis in bases for columns in basis if columns.shape[1]):
        by_width.setdefault(columns.shape[1], []).append(columns)
    largest = {  # share of pure noise by number of directions; one product reads the noise once
        width: (torch.cat(alike, dim=1).float().T @ noise).square().unflatten(0, (-1, width)).sum(1).amax(0)
        for width, alike in by_width.items()
    }
    n = len(fit.residual)
    drawn = [_p_values(of_noise, torch.tensor(k), n) for k, of_noise in largest.items()]
    smallest = torch.stack(drawn).amin(0)
    unadjusted = torch.where(n_directions > 0, _p_values(share, n_directions.clamp(min=1), n), 1.0)
    structures = []
    for covariate, basis, shares, p_values in zip(tested, bases, share, unadjusted.tolist(), strict=True):
        adjusted = float(((smallest <= min(p_values)).sum() + 1) / (N_NOISE_DRAWS + 1))
        expected = sum(columns.shape[1] for columns in basis) / len(direction)
        structures.append(
            Structure(
                covariate, adjusted, float(shares.sum()), expected, (p_values[0], p_values[1], p_values[2])
            )
        )
    return sorted(structures, key=lambda structure: (structure.p_value, min(structure.by_component)))


def _basis(fit: Fit, covariate: Covariate, axis: int) -> Float[Tensor, "component column"]:
    """Orthonormal smooth functions of a covariate in one component of the reading, less what the fit follows."""
    values = covariate.by_reading
    degree = min(SETTING_DEGREE, len(torch.unique(values)) - 1)
    smooth = legendre(unit_interval(values[:, None])[:, 0], max(degree, 1))
    smooth = smooth[:, 1 : degree + 1] if degree else smooth[:, :1]
    on_axis = torch.zeros(smooth.shape[1], len(values), 3, dtype=torch.float64)
    on_axis[:, :, axis] = smooth.T
    columns = (fit.posterior.measured_components(on_axis) * fit.whitening_per_T).T
    return _orthonormal(fit.projector.rest(columns), columns.norm(dim=0).max())


def _without(basis: Tensor, removed: Tensor) -> Tensor:
    """Orthonormal basis of what one basis spans beyond another."""
    return _orthonormal(basis - removed @ (removed.T @ basis), torch.ones((), dtype=torch.float64))


def _orthonormal(
    columns: Float[Tensor, "component column"], largest: Tensor
) -> Float[Tensor, "component direction"]:
    """Orthonormal basis of columns; directions that are rounding beside the largest size are left out."""
    left, size, _ = torch.linalg.svd(columns, full_matrices=False)
    return left[:, size > RANK_TOLERANCE * largest]


def _p_values(
    share: Float[Tensor, "*test"], n_directions: Int[Tensor, "*#test"], n: int
) -> Float[Tensor, "*test"]:
    """Probability that noise in n components has a larger share of its square along so many directions."""
    shape = 0.5 * n_directions.numpy()
    return torch.from_numpy(np.asarray(betaincc(shape, 0.5 * n - shape, share.clamp(0.0, 1.0).numpy())))


def _repeats(observations: Observations) -> tuple[Float[Tensor, " sensor"], int] | None:
    """Noise of a component of each sensor, and the degrees of freedom of all, from repeats at one pose and current.

    None where a sensor that was read has few.
    """
    key = torch.cat(
        [
            observations.sensor[:, None].to(torch.float64),
            observations.current_A,
            *observations.motion.values(),
        ],
        dim=1,
    )
    _, group = torch.unique(key, dim=0, return_inverse=True)
    total, n_free = torch.zeros(2, int(observations.sensor.max()) + 1, dtype=torch.float64)
    for axis in range(3):
        read = observations.is_measured[:, axis]
        value, group_read = observations.field_sensor_T[read, axis], group[read]
        number = torch.bincount(group_read, minlength=int(group.max()) + 1).to(torch.float64)
        mean = torch.zeros_like(number).index_add(0, group_read, value) / number.clamp(min=1.0)
        share = 1.0 - 1.0 / number[group_read]
        total.index_add_(0, observations.sensor[read], (value - mean[group_read]).square())
        n_free.index_add_(0, observations.sensor[read], share)
    are_read = observations.sensor.unique()
    if bool((n_free[are_read] < FEWEST_REPEATS - 0.5).any() or (total[are_read] == 0.0).any()):
        return None
    return torch.sqrt(total / n_free), round(float(n_free.sum()))


def _specified(fit: Fit) -> tuple[Float[Tensor, " sensor"], float]:
    """Noise of the components of each sensor by the rig file, and the smallest relative standard deviation of their priors."""
    nominal = fit.rig.nominal_values()
    parameters = [fit.rig.parameters[f"{sensor.name}.noise_T"] for sensor in fit.rig.sensors]
    expected = [nominal[p.name] if p.prior is None else p.prior.centre for p in parameters]
    widths = [p.prior.relative_sd for p in parameters if isinstance(p.prior, LogNormal)]
    return fit.vector.new_tensor(expected), min(widths, default=0.0)
