"""Running maximum of a posterior: one Gauss-Newton step for each new reading, and further ones on all readings while none waits.

Gradient and information of the log likelihood are sums over readings. They are accumulated at one point of linearisation; the maximum is a
Newton step from that point. `polish` sums the gradient of all readings again at the new maximum, until a step leads nowhere: that is the
maximum of the batch fit. Where a step is no longer small compared with the uncertainty, Levenberg-Marquardt fits all readings at once.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import inf

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.field.winding_shape import DEFAULT_TOLERANCE, Rule
from estimator.inference.levenberg_marquardt import (
    levenberg_marquardt,
    prior_gradient,
    prior_gradient_and_precision,
)
from estimator.inference.likelihood import LogPosterior
from estimator.inference.linearisation import Innovation, Linearisation
from estimator.inference.positive_definite import inverse, solve
from estimator.model.clearance import nearest_m
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.rig.coordinates import Coordinates, nominal_tensors
from estimator.rig.rig import Rig

# Predictions of a part of the readings: some 4 ms of a core for one coil, which is what a new reading may have to wait.
GRADIENT_READINGS, LINEARISED_PREDICTIONS = 2_000, 20_000


class Sweep:
    """Gradient of the log likelihood of all readings at a point, and their information if it is asked for.

    Args:
        posterior: Density of the readings.
        point: Where.
        is_linearising: Whether their information is summed too; that takes longer.

    Attributes:
        gradient, information: Sums over the parts so far.
    """

    def __init__(
        self, posterior: LogPosterior, point: Float[Tensor, " coordinate"], is_linearising: bool
    ) -> None:
        n = posterior.coordinates.n
        self.point, self.is_linearising = point, is_linearising
        self.n_readings = len(posterior.model.circumstances)
        self.gradient = torch.zeros(n, dtype=torch.float64)
        self.information = torch.zeros(n, n, dtype=torch.float64)
        self._posterior = posterior
        at_once = max(1, LINEARISED_PREDICTIONS // (2 * n + 1)) if is_linearising else GRADIENT_READINGS
        self._parts = list(torch.arange(self.n_readings).split(at_once))[::-1]

    @property
    def is_done(self) -> bool:
        """Whether all readings have been seen."""
        return not self._parts

    def take_part(self) -> None:
        """Add the next part of the readings."""
        part = self._parts.pop()
        self.add(self._posterior if len(part) == self.n_readings else self._posterior.part(part))

    def add(self, posterior: LogPosterior) -> None:
        """Add readings that are not among those of the density."""
        self.gradient = self.gradient + posterior.gradient(self.point)
        if self.is_linearising:
            linearisation = Linearisation.at(posterior, self.point)
            _, information = linearisation.gradient_and_information(posterior, self.point)
            self.information = self.information + information


FARTHEST_STEP = 0.5  # root mean square over the coordinates, in standard deviations
# Of a rule that is kept for later readings: ten times as exact as usual, since they may be as near to another side of the winding.
RULE_TOLERANCE = 0.1 * DEFAULT_TOLERANCE
TOLERANCE = 1e-3  # of log density: leaves a running estimate within a twentieth of a standard deviation of the maximum
# Lengths in standard deviations, as the precision measures them: no coordinate moves by more of its own.
POLISHED_SD = 1e-7  # from the maximum, by the rate at which steps shrink
LEAST_RATE = 0.1  # with curvature from secants, one step may shrink a thousandfold and the next one, in another direction, tenfold
ROUNDING_SD = 1e-9  # steps do not shrink further for certain
STALE_SD = 0.1  # root mean square over the coordinates: farther from where it was summed, the information is summed again
LEAST_MOVE_SD = 1e-5  # that curvature is learned from: rounding moves gradients by 1e-11
LEAST_CURVATURE = 0.1  # of the expected one along a step; less says that no maximum is near
MOST_SWEEPS = 30  # after a reading; a maximum at a bound of the prior is never reached


class RunningFit:
    """Maximum and curvature of the posterior of one rig.

    Args:
        rig: With priors.
        start: Values to begin from; nominal ones where they are not among them.
    Attributes:
        coordinates: Meaning of the vectors.
        vector: The maximum.
        precision: Negative Hessian of the log posterior.
        n_fits: Number of fits to all readings.
        n_sweeps: Number of times that polishing went through all readings.
        is_polished: Whether the vector is the maximum for all readings so far.
    """

    def __init__(self, rig: Rig, start: Mapping[str, float] | None = None) -> None:
        self.coordinates = Coordinates(rig)
        n = self.coordinates.n
        self.vector = self.coordinates.vector({**rig.nominal_values(), **(start or {})})
        self.n_fits = self.n_sweeps = 0
        self.is_polished = False
        self._point = self.vector
        self._gradient = torch.zeros(n, dtype=torch.float64)
        self._information = torch.zeros(n, n, dtype=torch.float64)
        self._prior_gradient = torch.zeros_like(self._gradient)
        self._prior_precision = torch.zeros_like(self._information)
        self._nearest_m: dict[str, float] = {}
        self._rules: dict[str, Rule] = {}
        self._posterior: LogPosterior | None = None
        self._sweep: Sweep | None = None
        self._is_exact = False  # whether the gradient at the point is that of all readings there
        self._n_sweeps_before = 0  # up to the last reading
        self._is_stuck = False
        self._step_sd = 0.0
        self._linearised_at = self.vector
        self._correction = torch.zeros_like(self._information)  # to the expected curvature, by secants
        self._evaluate_prior()

    @property
    def covariance(self) -> Float[Tensor, "coordinate coordinate"]:
        """Laplace covariance of the coordinates."""
        return inverse(self.precision)

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
        linearisation = Linearisation.at(posterior, self._point)
        innovation = linearisation.innovation(posterior, self.vector - self._point, self.covariance)
        gradient, information = linearisation.gradient_and_information(posterior, self._point)
        self._gradient = self._gradient + gradient
        self._information = self._information + information
        self._is_stuck = self.is_polished = False
        self._n_sweeps_before = self.n_sweeps
        self._step(observations)
        return innovation

    @property
    def can_polish(self) -> bool:
        """Whether `polish` may bring the vector nearer to the maximum."""
        return not (self.is_polished or self._is_stuck)

    def polish(self, observations: Observations) -> bool:
        """Do the next piece of polishing, some milliseconds of work.

        Args:
            observations: All readings up to now.
        Returns: Whether the vector changed.
        """
        if not self.can_polish:
            return False
        if self._sweep is None:
            if self._posterior is None or len(self._posterior.model.circumstances) < len(observations):
                # As any fit builds it: rules of its own would move the maximum by a thousandth of a standard deviation.
                model = MeasurementModel.build(self.coordinates.rig, observations)
                self._posterior = LogPosterior(self.coordinates, model, observations)
                return False
            self._sweep = Sweep(self._posterior, self.vector, self._is_far())
        self._sweep.take_part()
        if not self._sweep.is_done:
            return False
        self._end_sweep(self._sweep, observations)
        return True

    def _is_far(self) -> bool:
        """Whether the information was summed too far from here."""
        moved = self.vector - self._linearised_at
        return float(moved @ self.precision @ moved) > self.coordinates.n * STALE_SD**2

    def _end_sweep(self, sweep: Sweep, observations: Observations) -> None:
        """Go on from the point of a sweep, by a step with its sums."""
        self.n_sweeps += 1
        n_late = len(observations) - sweep.n_readings
        if n_late:  # they came while it went on
            late = observations.rows(torch.arange(sweep.n_readings, len(observations)))
            sweep.add(LogPosterior(self.coordinates, self._model(late), late))
        moved, gradient = sweep.point - self._point, self._gradient + self._prior_gradient
        self._sweep, self._point, self._gradient = None, sweep.point, sweep.gradient
        if sweep.is_linearising:
            self._information, self._linearised_at = sweep.information, sweep.point
            self._correction = torch.zeros_like(self._information)
            self._evaluate_prior()
        else:
            self._prior_gradient = prior_gradient(self.coordinates, self._point)
        before_sd = self._step_sd if self._is_exact else 0.0
        if self._is_exact and not sweep.is_linearising:
            self._learn(moved, gradient - self._gradient - self._prior_gradient)
        self._is_exact, n_fits = True, self.n_fits
        self._step(observations)
        if self.n_fits > n_fits:  # the step left the prior, or was too long
            self._is_stuck = True
            return
        rate = max(LEAST_RATE, self._step_sd / before_sd) if before_sd > 0.0 else inf
        left_sd = self._step_sd * rate / (1.0 - rate) if rate < 1.0 else inf
        is_reached = left_sd < POLISHED_SD or self._step_sd < ROUNDING_SD
        self.is_polished = is_reached and not n_late
        self._is_stuck = not is_reached and self.n_sweeps - self._n_sweeps_before >= MOST_SWEEPS

    def _learn(self, moved: Tensor, fall: Tensor) -> None:
        """Correct the curvature so that it explains by how much the gradient fell along a move.

        Expected curvature differs from the real one where noise is free, readings are outliers, or the model bends: steps with it would
        shrink slowly, or not at all.

        References: Nocedal and Wright, Numerical Optimization, 2nd ed., eq 6.19 (BFGS).
        """
        explained = (self.precision + self._correction) @ moved
        expected, real = float(moved @ explained), float(moved @ fall)
        if expected > LEAST_MOVE_SD**2 and real > LEAST_CURVATURE * expected:
            self._correction = (
                self._correction + fall.outer(fall) / real - explained.outer(explained) / expected
            )

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
        self.vector = self._point = self._linearised_at = fits.vector[best]
        self._information = fits.information[best]
        self._evaluate_prior()
        self._gradient = -self._prior_gradient  # the gradients cancel at the maximum
        self._correction = torch.zeros_like(self._information)
        self._sweep, self._is_exact = None, False
        self._is_stuck = self.is_polished = False
        self.n_fits += 1

    def _model(self, block: Observations) -> MeasurementModel:
        """Model of new readings. Rules of earlier ones serve where no sensor is nearer to a winding: to choose is a third of an update."""
        rig = self.coordinates.rig
        model = MeasurementModel.unruled(rig, block)
        distances_m = nearest_m(model)
        is_nearer = any(
            distance_m < self._nearest_m.get(name, inf) for name, distance_m in distances_m.items()
        )
        if not is_nearer and len(rig.wound) == len(rig.coils):
            return model.with_rules(self._rules)
        model = model.choose_rules(nominal_tensors(rig), RULE_TOLERANCE)
        for name, distance_m in distances_m.items():
            if distance_m < self._nearest_m.get(name, inf):
                self._nearest_m[name], self._rules[name] = distance_m, model.rules[name]
        return model

    def _step(self, observations: Observations) -> None:
        self.precision = self._information + self._prior_precision
        step = solve(self.precision + self._correction, self._gradient + self._prior_gradient)
        step_sd = float(step @ self.precision @ step) ** 0.5
        is_near = step_sd <= FARTHEST_STEP * self.coordinates.n**0.5
        is_inside = bool(torch.isfinite(self.coordinates.log_prior(self._point + step)))
        if is_near and is_inside:
            self.vector, self._step_sd = self._point + step, step_sd
        else:
            self.refit(observations, self._point)

    def _evaluate_prior(self) -> None:
        gradient, precision = prior_gradient_and_precision(self.coordinates, self._point[None])
        self._prior_gradient, self._prior_precision = gradient[0], precision[0]
        self.precision = self._information + self._prior_precision
