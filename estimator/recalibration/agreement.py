"""Does a new session agree with a calibration? A joint test against its posterior predictive distribution.

The prediction for the new readings is normal: the covariance J Sigma J^T of the parameters, from posterior draws, plus noise that is itself
uncertain by the posterior. The chi-square of the whitened residuals splits into a part that the free parameters can follow and a part that
they cannot. A third statistic tests each known cause along its own column, which detects effects far too small for chi-squares over
hundreds of components. The smallest of the three p-values is compared with its distribution over simulated sessions, so the false-alarm
rate is the stated one, whatever the dependence between the three.

References: Westfall and Young, Resampling-Based Multiple Testing (1993), section 2.3 (min-p); Gelman et al., Bayesian Data Analysis
(2013), chapter 6 (predictive checks).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from estimator.calibration.result import Calibration
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.hypotheses.candidates import candidates, causes_of
from estimator.diagnosis.limits import Limits
from estimator.inference.likelihood import LogPosterior
from estimator.inference.positive_definite import inverse
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.recalibration import policy
from estimator.rig.coordinates import Coordinates

AT_ONCE = 2_000  # simulated sessions in one batch, for the memory that they take
SMALLEST_SHARE = 1e-6  # of a column outside the span of the parameters: less is rounding
TESTS = ("parameters", "remainder", "causes")


@dataclass(frozen=True)
class Agreement:
    """Agreement of a session with a calibration.

    Attributes:
        p_value: Probability of so small a smallest p-value in sessions that agree; at least 5e-5.
        by_test: p-value of each test: the part that the parameters can follow, the remainder, the columns of known causes.
        left_p_value: p-value of the columns of known causes after a refit within its prior.
        rms_sigma: Rms of the residual, in standard deviations of the noise.
        striking_cause: Cause whose column stands out most after the refit; None where there are no causes.
    """

    p_value: float
    by_test: dict[str, float]
    left_p_value: float
    rms_sigma: float
    striking_cause: str | None

    @property
    def holds(self) -> bool:
        """Whether there is no reason to doubt the calibration."""
        return self.p_value > policy.FALSE_ALARMS

    @property
    def is_refit_enough(self) -> bool:
        """Whether other values of the same parameters leave nothing that looks like a known cause."""
        return self.left_p_value > policy.FALSE_ALARMS


def agreement(calibration: Calibration, observations: Observations, refit: Fit, seed: int) -> Agreement:
    """Test new readings against what a calibration predicts for them.

    Args:
        calibration: Calibration from other readings.
        observations: The new readings.
        refit: Fit of the same rig to the new readings.
        seed: Seed of the simulated sessions.
    """
    before = _Predictive.of(calibration, observations)
    after = before.widened(refit)
    names, columns = _cause_columns(refit, before.sigma_T)
    simulated, observed, _ = _tested(before, columns, seed)
    n = len(simulated)
    by_test = (1.0 + (simulated >= observed).sum(0)) / (n + 1.0)
    # p-value of each simulated session among the others, by test; the observed minimum is compared with their minima.
    rank = simulated.argsort(0, descending=True).argsort(0)
    smallest = ((rank + 1.0) / n).min(1).values
    simulated_after, observed_after, score = _tested(after, columns, seed)
    return Agreement(
        float((1.0 + (smallest <= by_test.min()).sum()) / (n + 1.0)),
        dict(zip(TESTS, by_test.tolist(), strict=True)),
        float((1.0 + (simulated_after[:, 2] >= observed_after[2]).sum()) / (n + 1.0)),
        float(before.residual.square().mean().sqrt()),
        names[int(score.argmax())] if names else None,
    )


def at_stored_draws(
    calibration: Calibration, observations: Observations
) -> tuple[LogPosterior, Float[Tensor, "draw coordinate"]]:
    """Density of some readings, and draws from the posterior of a calibration of the same rig in its coordinates."""
    coordinates = Coordinates(calibration.rig, integer_counts=True)
    values = calibration.draw_values(policy.N_DRAWS)
    model = MeasurementModel.for_values(calibration.rig, observations, calibration.best_values())
    vectors = coordinates.vector({name: values[name] for name in coordinates.names})
    return LogPosterior(coordinates, model, observations), vectors


@dataclass(frozen=True)
class _Predictive:
    """Predictive distribution of whitened readings: directions @ normal(0, spread) + noise.

    Attributes:
        sigma_T: Standard deviation of the noise of each component.
        residual: Readings less the mean prediction, in units of the noise.
        directions: Orthonormal directions in which the free parameters move the readings.
        spread: Standard deviation along each direction, in units of the noise.
        noise_sd: Standard deviation of the logarithm of the noise, by sensor.
        sensor: Sensor of each component.
        outliers: Share of outliers and their standard deviation in units of the noise, by component.
    """

    sigma_T: Float[Tensor, " component"]
    residual: Float[Tensor, " component"]
    directions: Float[Tensor, "component direction"]
    spread: Float[Tensor, " direction"]
    noise_sd: Float[Tensor, " sensor"]
    sensor: Int[Tensor, " component"]
    outliers: Float[Tensor, "2 component"]

    @classmethod
    def of(cls, calibration: Calibration, observations: Observations) -> _Predictive:
        """The predictive distribution from posterior draws."""
        rig, best = calibration.rig, calibration.best_values()
        posterior, vectors = at_stored_draws(calibration, observations)
        with torch.no_grad():
            predicted_T = posterior.predicted(vectors)
            log_sigma = torch.log(posterior.component_sigma_T(vectors))
        sigma_T, mean_T = torch.exp(log_sigma.mean(0)), predicted_T.mean(0)
        deviations = (predicted_T - mean_T) / sigma_T / len(predicted_T) ** 0.5
        _, spread, directions = torch.linalg.svd(deviations, full_matrices=False)
        n = min(len(rig.free), len(spread))
        noise_sd = torch.zeros(len(rig.sensors), dtype=torch.float64)
        noise_sd[posterior.sensor] = log_sigma.std(0)  # the same for all components of a sensor
        residual = (posterior.measured_T - mean_T) / sigma_T
        outliers = torch.stack(posterior.contamination(best))
        return cls(sigma_T, residual, directions[:n].T, spread[:n], noise_sd, posterior.sensor, outliers)

    def widened(self, refit: Fit) -> _Predictive:
        """This noise, with parameters that vary within the prior of a fit to these readings, to first order about the fit."""
        to_noise = 1.0 / (refit.whitening_per_T * self.sigma_T)
        jacobian = refit.jacobian * to_noise[:, None]
        prior_covariance = inverse(refit.prior_precision[None])[0]
        from_prior = jacobian @ (refit.vector - refit.posterior.coordinates.start())
        directions, spread, _ = torch.linalg.svd(
            jacobian @ torch.linalg.cholesky(prior_covariance), full_matrices=False
        )
        residual = refit.residual * to_noise + from_prior
        return replace(self, residual=residual, directions=directions, spread=spread)

    def weighted(self, vectors: Float[Tensor, "component column"]) -> Float[Tensor, "component column"]:
        """The inverse of the predictive covariance times vectors."""
        share = self.spread**2 / (1.0 + self.spread**2)
        return vectors - self.directions @ (share[:, None] * (self.directions.T @ vectors))

    def simulated(self, generator: torch.Generator) -> Iterator[Float[Tensor, "session component"]]:
        """Whitened residuals of simulated sessions that agree, `AT_ONCE` at a time."""

        def normal(*shape: int) -> Tensor:
            return torch.randn(*shape, generator=generator, dtype=torch.float64)

        for _ in range(policy.N_SIMULATED // AT_ONCE):
            moved = (normal(AT_ONCE, len(self.spread)) * self.spread) @ self.directions.T
            noise = torch.exp(normal(AT_ONCE, len(self.noise_sd)) * self.noise_sd)[:, self.sensor]
            share, ratio = self.outliers
            is_outlier = (
                torch.rand(AT_ONCE, len(self.sensor), generator=generator, dtype=torch.float64) < share
            )
            yield moved + torch.where(is_outlier, ratio, 1.0) * noise * normal(AT_ONCE, len(self.sensor))


def _tested(
    predictive: _Predictive, columns: Float[Tensor, "component column"], seed: int
) -> tuple[Float[Tensor, "session test"], Float[Tensor, " test"], Float[Tensor, " column"]]:
    """The three statistics of simulated sessions and of the readings, and the score of each cause's column in the readings."""
    weighted = predictive.weighted(columns)
    size = (columns * weighted).sum(0).clamp(min=0.0).sqrt()
    is_visible = size > SMALLEST_SHARE * columns.norm(dim=0)
    scores = torch.where(is_visible, weighted / size, torch.zeros_like(weighted))

    def statistics(residual: Float[Tensor, "session component"]) -> tuple[Tensor, Tensor]:
        along = residual @ predictive.directions
        parameters = (along**2 / (1.0 + predictive.spread**2)).sum(1)
        remainder = residual.square().sum(1) - along.square().sum(1)
        score = (residual @ scores).square()
        return torch.stack((parameters, remainder, score.max(1).values), dim=1), score

    generator = torch.Generator().manual_seed(seed)
    simulated = torch.cat([statistics(part)[0] for part in predictive.simulated(generator)])
    observed, score = statistics(predictive.residual[None])
    return simulated, observed[0], score[0]


def _cause_columns(
    refit: Fit, sigma_T: Float[Tensor, " component"]
) -> tuple[list[str], Float[Tensor, "component column"]]:
    """Names of causes and their columns in units of the noise: what each adds to the readings. Without causes, one column of zeros."""
    hypotheses = candidates(refit, causes_of(refit.rig, refit, Limits(is_of_change=True)))
    names = [hypothesis.cause.label for hypothesis in hypotheses for _ in hypothesis.keys]
    if not names:
        return [], torch.zeros(len(sigma_T), 1, dtype=torch.float64)
    to_noise = 1.0 / (refit.whitening_per_T * sigma_T)
    return names, torch.cat([hypothesis.columns for hypothesis in hypotheses], dim=1) * to_noise[:, None]
