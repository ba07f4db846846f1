"""The fit of one hypothesis: a rig with its effects, the maximum of its posterior density, and the Laplace evidence."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.special import log_ndtr

from estimator.derivatives import jacobian_of
from estimator.diagnosis import effort
from estimator.diagnosis.fit_journal import key_of
from estimator.diagnosis.fit_place import SETTING, climbed
from estimator.diagnosis.linear import MOST_NOISE_SHRINK, FreeNoise, Projector
from estimator.effects import EFFECTS
from estimator.effects.circumstances import Circumstances
from estimator.effects.use import Use
from estimator.field.winding_shape import Rule
from estimator.inference.laplace import log_evidence
from estimator.inference.levenberg_marquardt import Optimum, prior_gradient, prior_gradient_and_precision
from estimator.inference.likelihood import FirstOrder, LogPosterior
from estimator.inference.positive_definite import inverse, solve
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.rig.coordinates import Coordinates
from estimator.rig.parameters import LogNormal, Normal, Parameter
from estimator.rig.rig import Cause, Rig

# Standard deviations of a prior from its bound, within which the last Newton step leaves a number alone
NEAR_BOUND = 1e-3

ROUNDING = 1e-12  # readings that differ by less than this share of the largest are the same


@dataclass(frozen=True)
class Fit:
    """The maximum of the posterior density of one rig, given some readings.

    Attributes:
        posterior: Log posterior density, with continuous loop counts.
        optimum: The maximum and its curvature; one row.
    """

    posterior: LogPosterior
    optimum: Optimum

    @property
    def rig(self) -> Rig:
        """The rig with its effects."""
        return self.posterior.model.rig

    @property
    def vector(self) -> Float[Tensor, " coordinate"]:
        """Coordinates of the maximum."""
        return self.optimum.vector[0]

    def to(self, readings: Observations) -> Fit:
        """This fit of the same readings on another device, with all that is computed from it.

        Args:
            readings: The fitted readings there.
        """
        posterior = LogPosterior.by_rules(self.posterior.coordinates, readings, self.posterior.model.rules)
        return Fit(posterior, self.optimum.to(readings.device))

    def model_of(self, readings: Observations) -> MeasurementModel:
        """Model of other readings of the same rig, with the quadrature rules and maps of this fit."""
        fitted = self.posterior.model
        model = MeasurementModel.unruled(self.rig, readings)
        return model.with_rules(fitted.rules).with_maps(fitted.sources.maps)

    @cached_property
    def log_evidence(self) -> float:
        """Laplace evidence with normalised priors of the effects, up to a constant that rigs share if they differ only in effects."""
        normalisers = sum(p.prior.log_normaliser for p in _of_effects(self.rig) if p.prior is not None)
        return float(log_evidence(self.optimum)[0]) + normalisers + self._log_share_inside

    def foretold(self, rig: Rig) -> Fit:
        """The fit of a rig that differs in its priors alone, to second order about this maximum.

        Args:
            rig: With the same parameters.
        """
        posterior = LogPosterior.by_rules(Coordinates(rig), self.observations, self.posterior.model.rules)
        coordinates, vector = posterior.coordinates, self.optimum.vector
        of_prior, prior_precision = prior_gradient_and_precision(coordinates, vector)
        precision = self.optimum.information + prior_precision
        gradient = self.posterior.gradient(self.vector) + of_prior[0]
        before, after = (each.log_prior(vector) for each in (self.posterior.coordinates, coordinates))
        value = self.optimum.log_posterior + after - before + 0.5 * gradient @ solve(precision[0], gradient)
        return Fit(posterior, replace(self.optimum, log_posterior=value, precision=precision))

    @property
    def _log_share_inside(self) -> float:
        """Log share of Laplace's normal law that lies inside the bounds of the effects' priors, one coordinate at a time.

        At a bound the density may rise beyond it. The law has its maximum there, and is as much higher.
        """
        coordinates, own = self.posterior.coordinates, {p.name for p in _of_effects(self.rig)}
        rows = [i for i, p in enumerate(coordinates.parameters) if p.name in own and not p.is_positive]
        lower, upper = (bound[rows] for bound in coordinates.bounds())
        rise, sd = torch.zeros_like(lower), torch.diagonal(self.covariance)[rows].sqrt()
        if bool((is_held := self._is_at_bound[rows]).any()):
            gradient = self.posterior.gradient(self.vector) + prior_gradient(coordinates, self.vector)
            rise = torch.where(is_held, gradient[rows] * sd, 0.0)
        to_lower, to_upper = (((bound - self.vector[rows]) / sd - rise) for bound in (lower, upper))
        near, far = torch.minimum(to_upper, -to_lower), torch.minimum(to_lower, -to_upper)
        log_share = log_ndtr(near) + torch.log1p(-torch.exp(log_ndtr(far) - log_ndtr(near)))
        return float((0.5 * rise.square() + log_share).sum())

    @cached_property
    def values(self) -> dict[str, Tensor]:
        """Every number of the rig at the maximum."""
        with torch.no_grad():
            return self.posterior.coordinates.values(self.vector)

    @property
    def noises(self) -> dict[str, Tensor]:
        """Fitted noise of every sensor, by parameter."""
        names = [f"{sensor.name}.noise_T" for sensor in self.rig.sensors]
        return {name: self.values[name] for name in names}

    @cached_property
    def predicted_T(self) -> Float[Tensor, " component"]:
        """Prediction of the measured components at the maximum."""
        with torch.no_grad():
            return self.posterior.predicted(self.vector)

    @cached_property
    def at_sensor_T(self) -> Float[Tensor, "*#batch reading 3"]:
        """Field at the sensors at the maximum, before they show it."""
        with torch.no_grad():
            return self.posterior.model.at_sensor_T(self.values)

    @property
    def circumstances(self) -> Circumstances:
        """What effects see of the readings that were fitted."""
        return self.posterior.model.circumstances

    @property
    def observations(self) -> Observations:
        """The readings that were fitted."""
        return self.circumstances.observations

    def start_with(self, rig: Rig) -> dict[str, Tensor | float]:
        """Values to start another rig from: those of this fit; nominal ones for parameters that only the other rig has."""
        new = {name: p.value for name, p in rig.parameters.items() if name not in self.rig.parameters}
        return {**self.values, **new}

    @cached_property
    def whitening_per_T(self) -> Float[Tensor, " component"]:
        """Weight of each component: one over its noise, less where it is probably an outlier."""
        with torch.no_grad():
            sigma_T = self.posterior.component_sigma_T(self.vector)
            weight = self.posterior.weight(self.posterior.whitened(self.vector), self.vector)
        return torch.sqrt(weight) / sigma_T

    @cached_property
    def residual(self) -> Float[Tensor, " component"]:
        """Whitened residuals of the measured components after one last Newton step.

        Without that step, flexible curves that run nearly along the Jacobian would take incomplete convergence for structure.
        """
        with torch.no_grad():
            residual = (
                self.posterior.measured_T - self.posterior.predicted(self.vector)
            ) * self.whitening_per_T
        free = ~self._is_at_bound
        gradient = self.jacobian.T @ residual + jacobian_of(self.posterior.coordinates.log_prior, self.vector)
        step = solve(self.optimum.precision[0][free][:, free], gradient[free])
        return residual - self.jacobian[:, free] @ step

    @property
    def _is_at_bound(self) -> Bool[Tensor, " coordinate"]:
        """Coordinates at a prior bound."""
        coordinates = self.posterior.coordinates
        lower, upper = coordinates.bounds()
        value = torch.stack([self.values[name] for name in coordinates.names])
        near = NEAR_BOUND * value.new_tensor([p.prior.sd for p in coordinates.parameters if p.prior])
        return (value - lower < near) | (upper - value < near)

    @cached_property
    def jacobian(self) -> Float[Tensor, "component coordinate"]:
        """Whitened Jacobian of the predictions in the coordinates; that with which the climb ended is not made again."""
        slopes = self.optimum.slopes
        jacobian_T = (
            self.posterior.jacobian(self.optimum.vector)[0] if slopes is None else slopes.jacobian_T[0]
        )
        return jacobian_T * self.whitening_per_T[:, None]

    def slopes_for(self, posterior: LogPosterior, vector: Float[Tensor, "1 coordinate"]) -> FirstOrder:
        """Predictions and noise of a similar model of the same readings to first order, as a climb may start from.

        Derivatives in the coordinates that both models have are those of this fit; in the others they are exact.

        Args:
            posterior: Density of the other model.
            vector: Its coordinates, near this fit.
        """
        mine, other = self.posterior.coordinates, posterior.coordinates
        known = dict(zip(zip(mine.names, mine.labels, strict=True), range(mine.n), strict=True))
        keys = list(zip(other.names, other.labels, strict=True))
        is_new = torch.tensor([key not in known for key in keys], dtype=torch.bool, device=vector.device)
        new, shared = is_new.nonzero().flatten(), (~is_new).nonzero().flatten()
        source = [known[key] for key in keys if key in known]
        jacobian_T = vector.new_zeros(1, len(self.predicted_T), other.n)
        whitening_per_T = self.whitening_per_T.clamp(min=1e-300)
        jacobian_T[0, :, shared] = self.jacobian[:, source] / whitening_per_T[:, None]
        if len(new):
            jacobian_T[..., new] = posterior.to_first_order(vector, new).jacobian_T
        sigma_T = posterior.component_sigma_T(vector)
        return FirstOrder(self.predicted_T[None], sigma_T, jacobian_T, posterior.log_sigma_jacobian(vector))

    @cached_property
    def projector(self) -> Projector:
        """Projects on what the fit cannot follow."""
        return Projector.of(self.jacobian, self.prior_precision)

    @property
    def prior_precision(self) -> Float[Tensor, "coordinate coordinate"]:
        """Precision of the prior at the maximum."""
        return (self.optimum.precision - self.optimum.information)[0]

    @cached_property
    def covariance(self) -> Float[Tensor, "coordinate coordinate"]:
        """Laplace covariance of the coordinates."""
        return inverse(self.optimum.precision)[0]

    def value_sd(self, name: str, covariance: Tensor | None = None) -> float:
        """Standard deviation of a parameter in its own unit, to first order; 0 where it is fixed.

        Args:
            name: Of the parameter.
            covariance: Of the coordinates; that of the fit by default.
        """
        gradient = self.value_gradients[name]
        if covariance is None:
            covariance = self.covariance
        return float(torch.sqrt(gradient @ covariance @ gradient))

    def difference_sd(self, plus: str, minus: str) -> float:
        """Standard deviation of one parameter minus another of the same unit, to first order."""
        gradient = self.value_gradients[plus] - self.value_gradients[minus]
        return float(torch.sqrt(gradient @ self.covariance @ gradient))

    @cached_property
    def value_gradients(self) -> dict[str, Float[Tensor, " coordinate"]]:
        """Gradient of every number of the rig in the coordinates."""
        values = self.posterior.coordinates.values
        gradients = jacobian_of(lambda vector: torch.stack(list(values(vector).values())), self.vector)
        return dict(zip(self.values, gradients, strict=True))

    def null_values(self, cause: Cause) -> dict[str, Tensor]:
        """Values, by parameter, at which one of the rig's causes changes nothing; shapes keep theirs, unless there are no sizes."""
        quantities = EFFECTS[cause.name].quantities(self.circumstances.extent)
        sizes = [quantity for quantity in quantities if not quantity.is_shape] or quantities
        return {f"{cause.label}.{q.key}": self.vector.new_tensor(q.null) for q in sizes}

    def at_null(self, cause: Cause) -> tuple[list[int], Float[Tensor, " coordinate"]]:
        """Which coordinates say how large one of the rig's causes is, and what they are at its null; -inf is the logarithm of 0."""
        coordinates, nulls = self.posterior.coordinates, self.null_values(cause)
        rows = [i for i, name in enumerate(coordinates.names) if name in nulls]
        own = [(coordinates.parameters[i], nulls[coordinates.names[i]]) for i in rows]
        return rows, self.vector.new_tensor([float(v.log() if p.is_positive else v) for p, v in own])

    def has_nothing_of(self, cause: Cause) -> bool:
        """Whether one of the rig's causes is no farther from changing nothing than noise puts it: what it did, others do."""
        rows, null = self.at_null(cause)
        off = self.vector[rows] - null
        if not rows or not bool(torch.isfinite(off).all()):
            return False
        covariance = self.covariance[rows][:, rows]
        return float(off @ torch.linalg.solve(covariance, off)) < len(rows)

    def still_has(self, cause: Cause) -> bool:
        """Whether one of the rig's causes is still itself at the fitted values, as its effect defines it."""
        effect = EFFECTS[cause.name]
        return effect.is_itself(Use(effect, cause.place).theta(self.values), self.circumstances)

    def to_first_order(self, projector: Projector, residual: Float[Tensor, " component"]) -> Fit:
        """The fit with another projector and residual, all that the evidence of further columns depends on."""
        return _FirstOrderFit(self.posterior, self.optimum, projector, residual)

    @property
    def noise_widths(self) -> list[float]:
        """Relative width of the prior of each noise that is not known."""
        priors = [self.rig.parameters[f"{sensor.name}.noise_T"].prior for sensor in self.rig.sensors]
        return [p.relative_sd if isinstance(p, LogNormal) else 1.0 for p in priors if p is not None]

    @cached_property
    def free_noise(self) -> FreeNoise | None:
        """The fitted noise of the sensors, as far as it may shrink; None where the noise is known."""
        widths = self.noise_widths
        if not widths:
            return None
        noise_T = min(float(self.values[f"{sensor.name}.noise_T"]) for sensor in self.rig.sensors)
        rounding_T = resolution_T(self.posterior.measured_T) / math.sqrt(12.0)
        lowest = (
            max(math.log(rounding_T / noise_T), MOST_NOISE_SHRINK) if rounding_T > 0.0 else MOST_NOISE_SHRINK
        )
        return FreeNoise(float(len(self.residual)), min(widths), min(lowest, 0.0), self._tension)

    @property
    def _tension(self) -> float:
        """Sum of the squares of the parameters' distances from their priors, without noises and what may lie anywhere in a range."""
        noises = {f"{sensor.name}.noise_T" for sensor in self.rig.sensors}
        priors = {p.name: p.prior for p in self.rig.free if p.name not in noises}
        bell_shaped = {n: prior for n, prior in priors.items() if isinstance(prior, Normal | LogNormal)}
        return sum(prior.distance(float(self.values[n])) ** 2 for n, prior in bell_shaped.items())


@dataclass(frozen=True)
class _FirstOrderFit(Fit):
    """A fit with a projector and a residual in place of those that follow from its maximum."""

    projector: Projector
    residual: Float[Tensor, " component"]


def resolution_T(measured_T: Float[Tensor, " component"]) -> float:
    """Resolution of the recorded readings: the smallest difference between two of them; 0 where there is none.

    Examples:
        >>> resolution_T(torch.tensor([1.20e-3, 1.21e-3, 1.20e-3, 1.26e-3], dtype=torch.float64))
        1e-05
    """
    ordered = torch.unique(measured_T)
    steps = ordered.diff()
    steps = steps[steps > ROUNDING * ordered.abs().max()]
    return round(float(steps.min()), 15) if len(steps) else 0.0


def fit_rig(
    rig: Rig,
    observations: Observations,
    start: Mapping[str, Tensor | float],
    rules: Mapping[str, Rule],
    more_starts: int = 0,
    tolerance: float | None = None,
    near: Fit | None = None,
    other_start: Mapping[str, Tensor] | None = None,
    ends_exact: bool = True,
) -> Fit:
    """Maximise the posterior density from given values of the parameters and from some draws of the prior; keep the highest maximum.

    Args:
        rig: The rig with its effects.
        observations: The readings.
        start: Values by parameter; names that the rig does not have are ignored.
        rules: Quadrature rule of each winding.
        more_starts: Number of draws of the prior.
        tolerance: Rise in log density by a further step below which the fit stops; `effort.FINE_TOLERANCE` by default.
        near: Fit of a similar rig to the same readings, whose derivatives hold near the start: it is where the values come from.
        other_start: Values of some parameters that replace those of the start where the density is then higher.
        ends_exact: Make the Jacobian anew at the maximum; without it curvature and evidence are rough where many numbers are free.
    """
    posterior = LogPosterior.by_rules(Coordinates(rig), observations, rules)
    coordinates = posterior.coordinates
    vector = coordinates.vector({n: v for n, v in start.items() if n in rig.parameters})[None]
    if more_starts:
        vector = torch.cat(
            (vector, coordinates.sample_prior(np.random.default_rng(more_starts), more_starts))
        )
        vector = vector[torch.isfinite(posterior(vector))]
    if other_start is not None:
        other = coordinates.vector({n: v for n, v in {**start, **other_start}.items() if n in rig.parameters})
        vector = torch.cat((vector, other[None]))
        vector = vector[posterior(vector).argmax()][None]
    tolerance = effort.FINE_TOLERANCE if tolerance is None else tolerance
    if tolerance >= effort.ROUGH_TOLERANCE:
        tolerance = max(tolerance, 0.5 * coordinates.n * effort.ROUGH_TO_SD**2)
    setting = SETTING.get()
    journal = setting.journal
    key = "" if journal is None else key_of(rig, observations, vector, tolerance, rules, setting.place)
    if journal is not None and (known := journal.optimum(key)) is not None:
        return Fit(posterior, known.to(observations.device))
    is_near = near is not None and near.observations is observations
    optimum = climbed(
        posterior,
        vector,
        tolerance,
        setting.place,
        lambda: near.slopes_for(posterior, vector) if near and is_near else None,
        ends_exact,
    )
    best = optimum.highest()
    if journal is not None:
        journal.add(key, best)
    return Fit(posterior, best)


def _of_effects(rig: Rig) -> list[Parameter]:
    labels = tuple(f"{cause.label}." for cause in rig.acting)
    return [p for p in rig.free if p.name.startswith(labels)] if labels else []
