"""The maximum of a posterior that follows the readings: one Gauss-Newton step each, and Levenberg-Marquardt where that is not enough.

Gradient and information of the log likelihood are sums over readings. They are kept at one point; a reading adds its own share, and the
maximum is a Newton step from that point. Where the step is no longer small beside the uncertainty, all readings are taken about the new
maximum again.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.inference.laplace import covariance
from estimator.inference.levenberg_marquardt import levenberg_marquardt, prior_slope, solve
from estimator.inference.likelihood import LogPosterior
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.rig.coordinates import Coordinates
from estimator.rig.rig import Rig

DIFFERENCE = 1e-4  # of the prior's width: one batched prediction gives the slope of a few readings in a quarter of the time of dual numbers
FARTHEST_STEP = 0.5  # root mean square over the coordinates, in standard deviations
TOLERANCE = 1e-3  # of log density: a running estimate is a thousandth of a standard deviation off


@dataclass(frozen=True)
class Innovation:
    """What new readings say beyond what all before them had led to expect.

    Attributes:
        difference_T: Measured less expected, component by component as `LogPosterior` orders them.
        covariance_T2: Of the difference: noise, and what was not known of the rig.
        expected_T: Field that was expected, by reading.
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
        n_fits: How often all readings were taken again.
    """

    def __init__(self, rig: Rig) -> None:
        self.coordinates = Coordinates(rig)
        n = self.coordinates.n
        self.vector = self.coordinates.start()
        self.n_fits = 0
        self._point = self.vector
        self._gradient = torch.zeros(n, dtype=torch.float64)
        self._information = torch.zeros(n, n, dtype=torch.float64)
        self._take_prior()

    @property
    def covariance(self) -> Float[Tensor, "coordinate coordinate"]:
        """Of the coordinates, by Laplace."""
        return covariance(self.precision)

    def update(self, observations: Observations, n_new: int) -> Innovation:
        """Take new readings in.

        Args:
            observations: All readings up to now.
            n_new: How many of them, the last ones, are new.
        Returns: What was new about them.
        Raises:
            InvalidInput: A sensor would stand inside a winding.
        """
        block = observations.rows(torch.arange(len(observations) - n_new, len(observations)))
        posterior = LogPosterior(self.coordinates, MeasurementModel.build(self.coordinates.rig, block), block)
        linear = _Linear.of(posterior, self._point)
        innovation = linear.innovation(posterior, self.vector - self._point, self.covariance)
        gradient, information = linear.share(posterior, self._point)
        self._gradient = self._gradient + gradient
        self._information = self._information + information
        self._step(observations)
        return innovation

    def refit(self, observations: Observations, start: Float[Tensor, " coordinate"]) -> None:
        """Take all readings again, from a start that may be better."""
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
        self._take_prior()
        self._gradient = -self._prior_gradient  # which is what makes it the maximum
        self.n_fits += 1

    def _step(self, observations: Observations) -> None:
        self.precision = self._information + self._prior_precision
        step = solve(self.precision, self._gradient + self._prior_gradient)
        n = self.coordinates.n
        is_near = float(step @ self.precision @ step) <= n * FARTHEST_STEP**2
        inside = torch.isfinite(self.coordinates.log_prior(self._point + step))
        if is_near and bool(inside):
            self.vector = self._point + step
        else:
            self.refit(observations, self._point)

    def _take_prior(self) -> None:
        gradient, precision = prior_slope(self.coordinates, self._point[None])
        self._prior_gradient, self._prior_precision = gradient[0], precision[0]
        self.precision = self._information + self._prior_precision


@dataclass(frozen=True)
class _Linear:
    """Some readings about one point."""

    expected_T: Float[Tensor, "reading 3"]
    sigma_T: Float[Tensor, " component"]
    slope_T: Float[Tensor, "component coordinate"]
    log_sigma_slope: Float[Tensor, "component coordinate"]

    @classmethod
    def of(cls, posterior: LogPosterior, point: Float[Tensor, " coordinate"]) -> _Linear:
        coordinates = posterior.coordinates
        step = DIFFERENCE * coordinates.scale
        around = torch.cat((point[None], point + torch.diag(step), point - torch.diag(step)))
        with torch.no_grad():
            field_T = posterior.model.predict(coordinates.values(around)).expand(len(around), -1, 3)
            sigma_T = posterior.component_sigma_T(around)

        def slope(values: Tensor) -> Tensor:
            up, down = values[1:].split(coordinates.n)
            difference: Tensor = ((up - down) / (2.0 * step[:, None])).mT
            return difference

        slope_T = slope(posterior.measured_components(field_T))
        return cls(field_T[0], sigma_T[0], slope_T, slope(torch.log(sigma_T)))

    def innovation(self, posterior: LogPosterior, step: Tensor, covariance: Tensor) -> Innovation:
        """Of the readings, at a small step from the point."""
        expected_T = posterior.measured_components(self.expected_T) + self.slope_T @ step
        spread_T2 = self.slope_T @ covariance @ self.slope_T.mT + torch.diag(self.sigma_T**2)
        return Innovation(posterior.measured_T - expected_T, spread_T2, self.expected_T)

    def share(self, posterior: LogPosterior, point: Tensor) -> tuple[Tensor, Tensor]:
        """Of gradient and information of the log likelihood at the point; that of the noise as it is expected to be."""
        whitened = (posterior.measured_T - posterior.measured_components(self.expected_T)) / self.sigma_T
        weight = posterior.weight(whitened, point)
        jacobian, noise = self.slope_T / self.sigma_T[:, None], self.log_sigma_slope
        gradient = jacobian.mT @ (weight * whitened) + noise.mT @ (weight * whitened**2 - 1.0)
        information = jacobian.mT @ (weight[:, None] * jacobian) + 2.0 * noise.mT @ noise
        return gradient, information
