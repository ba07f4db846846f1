"""Running maximum of a posterior: one Gauss-Newton step for each new reading, and Levenberg-Marquardt if that does not suffice.

Gradient and information of the log likelihood are sums over readings. They are accumulated at one point of linearisation; the maximum is a
Newton step from that point. Once the step is no longer small compared with the uncertainty, all readings are linearised again about the new
maximum.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.field.winding import DEFAULT_TOLERANCE, Rule
from estimator.inference.laplace import covariance
from estimator.inference.levenberg_marquardt import levenberg_marquardt, prior_gradient_and_precision, solve
from estimator.inference.likelihood import LogPosterior
from estimator.model.measurement_model import MeasurementModel, nominal_tensors
from estimator.readings.observations import Observations
from estimator.rig.coordinates import Coordinates
from estimator.rig.rig import Rig

# Of the prior's width: central differences in one batched prediction take a quarter of the time of dual numbers for a few readings.
DIFFERENCE_STEP = 1e-4
FARTHEST_STEP = 0.5  # root mean square over the coordinates, in standard deviations
# Of a rule that is kept for later readings: ten times as exact as usual, since they may be as near to another side of the winding.
RULE_TOLERANCE = 0.1 * DEFAULT_TOLERANCE
TOLERANCE = 1e-3  # of log density: leaves a running estimate within a twentieth of a standard deviation of the maximum


@dataclass(frozen=True)
class Innovation:
    """Difference of new readings from the prediction by all earlier ones (innovation of a Kalman filter).

    Attributes:
        difference_T: Measured minus expected, in the order of components of `LogPosterior`.
        covariance_T2: Covariance of the difference: noise plus uncertainty of the parameters.
        expected_T: Expected field of each reading.
    """

    difference_T: Float[Tensor, " component"]
    covariance_T2: Float[Tensor, "component component"]
    expected_T: Float[Tensor, "reading 3"]


class RunningFit:
    """Maximum and curvature of the posterior of one rig.

    Attributes:
        coordinates: Meaning of the vectors.
        vector: The maximum.
        precision: Negative Hessian of the log posterior.
        n_fits: Number of fits to all readings.
    """

    def __init__(self, rig: Rig) -> None:
        self.coordinates = Coordinates(rig)
        n = self.coordinates.n
        self.vector = self.coordinates.start()
        self.n_fits = 0
        self._point = self.vector
        self._gradient = torch.zeros(n, dtype=torch.float64)
        self._information = torch.zeros(n, n, dtype=torch.float64)
        self._nearest_m: dict[str, float] = {}
        self._rules: dict[str, Rule] = {}
        self._evaluate_prior()

    @property
    def covariance(self) -> Float[Tensor, "coordinate coordinate"]:
        """Laplace covariance of the coordinates."""
        return covariance(self.precision)

    def update(self, observations: Observations, n_new: int) -> Innovation:
        """Update the maximum with new readings.

        Args:
            observations: All readings up to now.
            n_new: Number of new readings, the last ones.
        Returns: Their innovation.
        Raises:
            InvalidInput: A sensor would stand inside a winding.
        """
        block = observations.rows(torch.arange(len(observations) - n_new, len(observations)))
        posterior = LogPosterior(self.coordinates, self._model(block), block)
        linearisation = _Linearisation.at(posterior, self._point)
        innovation = linearisation.innovation(posterior, self.vector - self._point, self.covariance)
        gradient, information = linearisation.gradient_and_information(posterior, self._point)
        self._gradient = self._gradient + gradient
        self._information = self._information + information
        self._step(observations)
        return innovation

    def refit(self, observations: Observations, start: Float[Tensor, " coordinate"]) -> None:
        """Fit all readings again, from the current maximum and from a start that may be better."""
        model = MeasurementModel.build(self.coordinates.rig, observations)
        posterior = LogPosterior(self.coordinates, model, observations)
        starts = torch.stack((self.vector, start))
        starts = starts[torch.isfinite(posterior(starts))]
        fits = levenberg_marquardt(
            posterior, starts if len(starts) else self._point[None], tolerance=TOLERANCE
        )
        best = int(fits.log_posterior.argmax())
        self.vector = self._point = fits.vector[best]
        self._information = fits.information[best]
        self._evaluate_prior()
        self._gradient = -self._prior_gradient  # the gradients cancel at the maximum
        self.n_fits += 1

    def _model(self, block: Observations) -> MeasurementModel:
        """Model of new readings. Rules of earlier ones serve where no sensor is nearer to a winding: to choose is a third of an update."""
        rig = self.coordinates.rig
        model = MeasurementModel.unruled(rig, block)
        nearest_m = model.nearest_m()
        is_nearer = any(distance_m < self._nearest_m.get(name, inf) for name, distance_m in nearest_m.items())
        if not is_nearer and len(rig.wound) == len(rig.coils):
            return model.with_rules(self._rules)
        model = model.choose_rules(nominal_tensors(rig), RULE_TOLERANCE)
        for name, distance_m in nearest_m.items():
            if distance_m < self._nearest_m.get(name, inf):
                self._nearest_m[name], self._rules[name] = distance_m, model.rules[name]
        return model

    def _step(self, observations: Observations) -> None:
        self.precision = self._information + self._prior_precision
        step = solve(self.precision, self._gradient + self._prior_gradient)
        n = self.coordinates.n
        is_near = float(step @ self.precision @ step) <= n * FARTHEST_STEP**2
        is_inside = bool(torch.isfinite(self.coordinates.log_prior(self._point + step)))
        if is_near and is_inside:
            self.vector = self._point + step
        else:
            self.refit(observations, self._point)

    def _evaluate_prior(self) -> None:
        gradient, precision = prior_gradient_and_precision(self.coordinates, self._point[None])
        self._prior_gradient, self._prior_precision = gradient[0], precision[0]
        self.precision = self._information + self._prior_precision


@dataclass(frozen=True)
class _Linearisation:
    """Predictions and noise of some readings at one point, with their Jacobians."""

    expected_T: Float[Tensor, "reading 3"]
    sigma_T: Float[Tensor, " component"]
    jacobian_T: Float[Tensor, "component coordinate"]
    log_sigma_jacobian: Float[Tensor, "component coordinate"]

    @classmethod
    def at(cls, posterior: LogPosterior, point: Float[Tensor, " coordinate"]) -> _Linearisation:
        coordinates = posterior.coordinates
        step = DIFFERENCE_STEP * coordinates.scale
        around = torch.cat((point[None], point + torch.diag(step), point - torch.diag(step)))
        with torch.no_grad():
            field_T = posterior.model.predict(coordinates.values(around)).expand(len(around), -1, 3)
            sigma_T = posterior.component_sigma_T(around)

        def jacobian(values: Tensor) -> Tensor:
            up, down = values[1:].split(coordinates.n)
            quotient: Tensor = ((up - down) / (2.0 * step[:, None])).mT
            return quotient

        jacobian_T = jacobian(posterior.measured_components(field_T))
        return cls(field_T[0], sigma_T[0], jacobian_T, jacobian(torch.log(sigma_T)))

    def innovation(self, posterior: LogPosterior, step: Tensor, covariance: Tensor) -> Innovation:
        """Innovation of the readings at a small step from the point."""
        expected_T = posterior.measured_components(self.expected_T) + self.jacobian_T @ step
        covariance_T2 = self.jacobian_T @ covariance @ self.jacobian_T.mT + torch.diag(self.sigma_T**2)
        return Innovation(posterior.measured_T - expected_T, covariance_T2, self.expected_T)

    def gradient_and_information(self, posterior: LogPosterior, point: Tensor) -> tuple[Tensor, Tensor]:
        """Contribution of the readings to gradient and information of the log likelihood; information on the noise is the expected one."""
        whitened = (posterior.measured_T - posterior.measured_components(self.expected_T)) / self.sigma_T
        weight = posterior.weight(whitened, point)
        jacobian, noise_jacobian = self.jacobian_T / self.sigma_T[:, None], self.log_sigma_jacobian
        gradient = jacobian.mT @ (weight * whitened) + noise_jacobian.mT @ (weight * whitened**2 - 1.0)
        information = jacobian.mT @ (weight[:, None] * jacobian) + 2.0 * noise_jacobian.mT @ noise_jacobian
        return gradient, information
