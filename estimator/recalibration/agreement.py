"""Does a new session agree with a calibration? A joint test against its posterior predictive distribution.

What the calibration predicts for the new readings is normal: its own uncertainty, J Sigma J^T from draws of the posterior, and noise known
as well as the posterior knows it. Whitened by the noise, the chi-square of the residuals falls into a part that the free parameters could
follow and a part that they could not; and each known cause is asked for by its own column, which sees effects far too small for
chi-squares over hundreds of components. The smallest of the three p-values is judged by its own distribution over simulated sessions,
so that the false-alarm rate is the one stated, however the three depend on each other.

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
from estimator.inference.laplace import covariance
from estimator.inference.likelihood import LogPosterior
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.recalibration import policy
from estimator.rig.coordinates import Coordinates

AT_ONCE = 2_000  # simulated sessions in one batch, for the memory that they take
SMALLEST_SHARE = 1e-6  # of a column that the parameters leave: the rest is rounding
TESTS = ("parameters", "remainder", "causes")


@dataclass(frozen=True)
class Agreement:
    """Of a session with a calibration.

    Attributes:
        p_value: Of the most striking of the tests, all of them considered; at least 5e-5.
        by_test: p-value of each by itself: what the parameters could follow, what they could not, what known causes look like.
        left_p_value: Of what known causes look like, in what the prior of the refit does not allow for.
        rms_sigma: Of the residual, in standard deviations of the noise.
        striking_cause: Whose column stands out most in that.
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
        calibration: Made from other readings.
        observations: The new readings.
        refit: Of the same rig to these readings.
        seed: Of the simulated sessions.
    """
    before = _Predictive.of(calibration, observations)
    after = before.widened(refit)
    names, columns = _cause_columns(refit, before.sigma_T)
    simulated, own, _ = _tested(before, columns, seed)
    n = len(simulated)
    by_test = (1.0 + (simulated >= own).sum(0)) / (n + 1.0)
    # The p-value of each simulated session among the others, test by test; its smallest is what ours is compared with.
    rank = simulated.argsort(0, descending=True).argsort(0)
    smallest = ((rank + 1.0) / n).min(1).values
    simulated_left, own_left, score = _tested(after, columns, seed)
    return Agreement(
        float((1.0 + (smallest <= by_test.min()).sum()) / (n + 1.0)),
        dict(zip(TESTS, by_test.tolist(), strict=True)),
        float((1.0 + (simulated_left[:, 2] >= own_left[2]).sum()) / (n + 1.0)),
        float(before.residual.square().mean().sqrt()),
        names[int(score.argmax())] if names else None,
    )


@dataclass(frozen=True)
class _Predictive:
    """Predictive distribution of whitened readings: directions @ normal(0, spread) + noise.

    Attributes:
        sigma_T: Noise by component.
        residual: Of the readings from the mean prediction, in noise.
        directions: Orthonormal; what the free parameters change.
        spread: Standard deviation along each, in noise.
        noise_sd: Uncertainty of the logarithm of the noise, by sensor.
        sensor: Of each component.
        wild: Share of outliers and how much wider they are, by component.
    """

    sigma_T: Float[Tensor, " component"]
    residual: Float[Tensor, " component"]
    directions: Float[Tensor, "component direction"]
    spread: Float[Tensor, " direction"]
    noise_sd: Float[Tensor, " sensor"]
    sensor: Int[Tensor, " component"]
    wild: Float[Tensor, "2 component"]

    @classmethod
    def of(cls, calibration: Calibration, observations: Observations) -> _Predictive:
        """From draws of the posterior."""
        rig = calibration.rig
        coordinates = Coordinates(rig, integer_counts=True)
        values = calibration.draw_values(policy.N_DRAWS)
        vectors = coordinates.vector({name: values[name] for name in coordinates.names})
        best = {name: torch.tensor(value, dtype=torch.float64) for name, value in calibration.best.items()}
        posterior = LogPosterior(
            coordinates, MeasurementModel.unruled(rig, observations).choose_rules(best), observations
        )
        with torch.no_grad():
            predicted_T = posterior.predicted(vectors)
            log_sigma = torch.log(posterior.component_sigma_T(vectors))
        sigma_T, mean_T = torch.exp(log_sigma.mean(0)), predicted_T.mean(0)
        off = (predicted_T - mean_T) / sigma_T / len(predicted_T) ** 0.5
        _, spread, directions = torch.linalg.svd(off, full_matrices=False)
        n = min(len(rig.free), len(spread))
        noise_sd = torch.zeros(len(rig.sensors), dtype=torch.float64)
        noise_sd[posterior.sensor] = log_sigma.std(0)  # the same for all components of a sensor
        residual = (posterior.measured_T - mean_T) / sigma_T
        wild = torch.stack(posterior.contamination(best))
        return cls(sigma_T, residual, directions[:n].T, spread[:n], noise_sd, posterior.sensor, wild)

    def widened(self, refit: Fit) -> _Predictive:
        """The same noise about what the prior of a fit allows, to first order about that fit to these readings."""
        to_noise = 1.0 / (refit.whitening_per_T * self.sigma_T)
        slope = refit.jacobian * to_noise[:, None]
        prior_covariance = covariance(refit.optimum.precision - refit.optimum.information)[0]
        moved = slope @ (refit.vector - refit.posterior.coordinates.start())
        directions, spread, _ = torch.linalg.svd(
            slope @ torch.linalg.cholesky(prior_covariance), full_matrices=False
        )
        residual = refit.residual * to_noise + moved
        return replace(self, residual=residual, directions=directions, spread=spread)

    def weighted(self, vectors: Float[Tensor, "component column"]) -> Float[Tensor, "component column"]:
        """Inverse of the predictive covariance times vectors."""
        share = self.spread**2 / (1.0 + self.spread**2)
        return vectors - self.directions @ (share[:, None] * (self.directions.T @ vectors))

    def simulated(self, generator: torch.Generator) -> Iterator[Float[Tensor, "session component"]]:
        """Whitened residuals of sessions that agree, some at a time."""

        def normal(*shape: int) -> Tensor:
            return torch.randn(*shape, generator=generator, dtype=torch.float64)

        for _ in range(policy.N_SIMULATED // AT_ONCE):
            moved = (normal(AT_ONCE, len(self.spread)) * self.spread) @ self.directions.T
            noise = torch.exp(normal(AT_ONCE, len(self.noise_sd)) * self.noise_sd)[:, self.sensor]
            share, ratio = self.wild
            is_wild = torch.rand(AT_ONCE, len(self.sensor), generator=generator, dtype=torch.float64) < share
            yield moved + torch.where(is_wild, ratio, 1.0) * noise * normal(AT_ONCE, len(self.sensor))


def _tested(
    predictive: _Predictive, columns: Float[Tensor, "component column"], seed: int
) -> tuple[Float[Tensor, "session test"], Float[Tensor, " test"], Float[Tensor, " column"]]:
    """The three statistics of simulated sessions and of the readings, and how much each cause's column stands out in these."""
    weighted = predictive.weighted(columns)
    size = (columns * weighted).sum(0).clamp(min=0.0).sqrt()
    can_be_seen = size > SMALLEST_SHARE * columns.norm(dim=0)
    scores = torch.where(can_be_seen, weighted / size, torch.zeros_like(weighted))

    def statistics(residual: Float[Tensor, "session component"]) -> tuple[Tensor, Tensor]:
        along = residual @ predictive.directions
        parameters = (along**2 / (1.0 + predictive.spread**2)).sum(1)
        remainder = residual.square().sum(1) - along.square().sum(1)
        score = (residual @ scores).square()
        return torch.stack((parameters, remainder, score.max(1).values), dim=1), score

    generator = torch.Generator().manual_seed(seed)
    simulated = torch.cat([statistics(part)[0] for part in predictive.simulated(generator)])
    own, score = statistics(predictive.residual[None])
    return simulated, own[0], score[0]


def _cause_columns(
    refit: Fit, sigma_T: Float[Tensor, " component"]
) -> tuple[list[str], Float[Tensor, "component column"]]:
    """Names of causes and what each would add to the readings, in noise; a column of zeros where there are none."""
    found = candidates(refit, causes_of(refit.rig, refit))
    names = [one.cause.label for one in found for _ in one.keys]
    if not names:
        return [], torch.zeros(len(sigma_T), 1, dtype=torch.float64)
    to_noise = 1.0 / (refit.whitening_per_T * sigma_T)
    return names, torch.cat([one.columns for one in found], dim=1) * to_noise[:, None]
