"""Validation of an extension: how well the fits before and after predict readings that neither was fitted to."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import torch
from jaxtyping import Float
from scipy.special import ndtr, stdtrit
from torch import Tensor

from estimator.calibration.result import Calibration
from estimator.derivatives import value_and_jacobian
from estimator.devices import numpy_of
from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.predicted_field import PredictedReadings, not_predicted
from estimator.effects.use import as_meant, is_in_field
from estimator.inference.directions import Directions
from estimator.inference.likelihood import LogPosterior
from estimator.inference.noise_of_readings import noise_rms_T, noise_words, scatter_of_sensors
from estimator.readings.metrics import ErrorMetrics, error_metrics
from estimator.readings.observations import Observations
from estimator.rig.rig import Cause

LEAST_IMPROVEMENT_SE = 2.0  # from which on a rise of the log predictive density is significant: 2 % by chance

SAME_ERROR = 0.02  # relative difference of two errors that are told as one
N_DRAWS = 200  # of the posterior, for predictive densities
DRAWS_AT_ONCE = 20  # so that maps of thousands of readings fit the memory
N_SHOWN = 40  # of them, whose predicted field is computed: each takes a hundredth of a second
# Readings that the intervals of predicted fields are held against: their coverage is known to 1 % then
MOST_COVERED = 400


@dataclass(frozen=True)
class ValidationScores:
    """How well one fit predicts unseen readings.

    Attributes:
        errors: Of the predictions.
        elpd: Expected log predictive density, summed over the readings.
        coverage50, coverage90: Share of the components inside the 50 % and 90 % predictive intervals.
        log_density: Log predictive density of each reading.
        predicted: Errors of the field that `predict` gives, which has nothing that only these readings have.
        coverage_of_prediction: Computes the coverage of its intervals.
        of_noise: Computes the rms length of an error by noise alone, and gives the words that tell where it is from.
    """

    errors: ErrorMetrics
    elpd: float
    coverage50: float
    coverage90: float
    log_density: Float[Tensor, " reading"]
    predicted: ErrorMetrics
    coverage_of_prediction: Callable[[], float] = field(repr=False, compare=False)
    of_noise: Callable[[], tuple[float, str]] = field(repr=False, compare=False)

    @cached_property
    def predicted_coverage90(self) -> float:
        """Share of the components inside its 90 % intervals; most scores are never asked for it."""
        return self.coverage_of_prediction()

    @property
    def is_of_field(self) -> bool:
        """Whether the predicted field has all that was fitted to readings, up to the last digits of an error."""
        return math.isclose(self.predicted.vector_T, self.errors.vector_T, rel_tol=SAME_ERROR)

    def to_json(self) -> dict[str, Any]:
        """These scores in the form of JSON; None stands for what does not apply, such as angles where one component was measured."""
        numbers = {
            **asdict(self.errors),
            "coverage50": self.coverage50,
            "coverage90": self.coverage90,
            "elpd": self.elpd,
            "predicted_vector_T": self.predicted.vector_T,
            "predicted_coverage90": self.predicted_coverage90,
        }
        return {name: value if math.isfinite(value) else None for name, value in numbers.items()}


@dataclass(frozen=True)
class Improvement:
    """Scores of the fits before and after the extension, and their difference.

    Attributes:
        elpd_difference, elpd_se: Elpd after less elpd before, and its standard error over readings.
        moved_sd: Shift of each parameter of the rig, in standard deviations of the fit before.
        known_before: Value and standard deviation of each in the fit before.
        not_predicted: Causes after it that only readings of this session have.
    """

    before: ValidationScores
    after: ValidationScores
    elpd_difference: float
    elpd_se: float
    moved_sd: dict[str, float]
    known_before: dict[str, tuple[float, float]] = field(default_factory=dict)
    not_predicted: tuple[Cause, ...] = ()

    def with_after(self, after: ValidationScores) -> Improvement:
        """This improvement with other scores of the later model."""
        difference, se = _difference(self.before, after)
        return replace(self, after=after, elpd_difference=difference, elpd_se=se)

    @property
    def is_significant(self) -> bool:
        """Whether the elpd rises by more than chance explains."""
        return self.elpd_difference > self._by_chance(LEAST_IMPROVEMENT_SE)

    @property
    def is_loss(self) -> bool:
        """Whether the elpd falls by more than chance explains."""
        return self.elpd_difference < -self._by_chance(policy.LEAST_LOSS_SE)

    def _by_chance(self, least_se: float) -> float:
        """What a difference exceeds by chance as often as a normal number so many of its standard errors.

        The standard error of few readings is itself uncertain: their mean over it follows Student's t.
        """
        freedom = max(len(self.before.log_density) - 1, 1)
        return self.elpd_se * float(-stdtrit(freedom, ndtr(-least_se)))


def improvement_of(
    before: Fit,
    after: Fit,
    unseen: Observations,
    widened: Float[Tensor, "coordinate coordinate"] | None = None,
) -> Improvement:
    """Compare two fits on readings that neither has seen.

    Args:
        before, after: The fits.
        unseen: The readings.
        widened: Covariance that stands for the later fit's own, where something unexplained has widened it.
    """
    scores = validation_scores(before, unseen), validation_scores(after, unseen, widened)
    lacking = () if scores[1].is_of_field else not_predicted(after, unseen)
    return replace(improvement_between(before, after, *scores), not_predicted=lacking)


def improvement_between(
    before: Fit, after: Fit, scores_before: ValidationScores, scores_after: ValidationScores
) -> Improvement:
    """Compare two fits by their scores on the same readings."""
    difference, se = _difference(scores_before, scores_after)
    known = {n: (float(before.values[n]), before.value_sd(n)) for n in before.posterior.coordinates.names}
    moved_sd = {name: (float(after.values[name]) - value) / sd for name, (value, sd) in known.items()}
    return Improvement(scores_before, scores_after, difference, se, moved_sd, known)


def _difference(before: ValidationScores, after: ValidationScores) -> tuple[float, float]:
    """Elpd after less elpd before, and its standard error over readings."""
    difference = after.log_density - before.log_density
    n = len(difference)
    return float(difference.sum()), float(difference.std() * math.sqrt(n)) if n > 1 else math.nan


def validation_scores(
    fit: Fit,
    unseen: Observations,
    widened: Float[Tensor, "coordinate coordinate"] | None = None,
    draws: Float[Tensor, "draw coordinate"] | None = None,
) -> ValidationScores:
    """Errors, log predictive density and coverage of a fit's predictions, with noise as uncertain as the rest.

    Args:
        fit: The rig and its numbers.
        unseen: Readings that it was not fitted to.
        widened: Covariance that stands for that of Laplace's approximation, by which predictions scatter to first order.
        draws: From the posterior, where it was sampled; predictions scatter as theirs do.
    """
    unseen = as_meant(fit.rig, unseen)
    model = fit.model_of(unseen).choose_rules(fit.values, is_refusing=False)
    posterior = LogPosterior(fit.posterior.coordinates, model, unseen)
    covariance = fit.covariance if widened is None else widened
    with torch.no_grad():
        predicted_T = model.predict(fit.values).expand(len(unseen), 3)
        noise_T = posterior.component_sigma_T(_draws(fit, covariance) if draws is None else draws)
        if draws is None:
            middle_T = posterior.measured_components(predicted_T)
            variance = _to_first_order(posterior.jacobian(fit.vector), covariance)
        else:
            each_T = torch.cat([posterior.predicted(some) for some in draws.split(DRAWS_AT_ONCE)])
            middle_T, variance = each_T.mean(0), each_T.var(0)
    log_density, below = _mixture(posterior, fit, middle_T, noise_T, variance)
    if draws is not None:  # intervals are quantiles of draws, which need not be normal
        _, below = _mixture(posterior, fit, each_T, noise_T, torch.zeros_like(variance))
    reading = torch.arange(len(unseen), device=unseen.device)[:, None].expand(-1, 3)[unseen.is_measured]
    by_reading = log_density.new_zeros(len(unseen)).index_add(0, reading, log_density)
    coverage = {p: _inside(below, p) for p in (0.5, 0.9)}
    shown_T = predicted_T
    of_prediction = partial(_inside, below, 0.9)
    if fit.rig.acting:
        with torch.no_grad():
            shown_T = PredictedReadings(fit, unseen).shown_T(fit.values)
        of_prediction = partial(_predicted_coverage90, fit, unseen, covariance, draws)
    is_on = numpy_of((unseen.current_A != 0.0).any(-1))
    errors, predicted = (
        error_metrics(numpy_of(unseen.field_sensor_T), numpy_of(each), is_on)
        for each in (predicted_T, shown_T)
    )
    elpd, noise = float(by_reading.sum()), partial(_noise_and_words, fit, unseen)
    return ValidationScores(
        errors, elpd, coverage[0.5], coverage[0.9], by_reading, predicted, of_prediction, noise
    )


def _noise_and_words(fit: Fit, unseen: Observations) -> tuple[float, str]:
    """What noise leaves of readings, by the rig file, and by those that were fitted where a sensor read often at one place."""
    scatter = scatter_of_sensors(fit.rig, fit.observations)
    return noise_rms_T(fit.rig, unseen, fit.rig.nominal_values(), scatter), noise_words(bool(scatter))


def _inside(below: Float[Tensor, " component"], share: float) -> float:
    """Share of components inside central intervals, by the probability below each."""
    return float(((below - 0.5).abs() <= 0.5 * share).double().mean())


def _predicted_coverage90(
    fit: Fit,
    unseen: Observations,
    covariance: Float[Tensor, "coordinate coordinate"],
    draws: Float[Tensor, "draw coordinate"] | None,
) -> float:
    """Share of components inside the 90 % intervals of the predicted field, of some readings."""
    few = unseen.rows(torch.arange(0, len(unseen), 1 + len(unseen) // MOST_COVERED, device=unseen.device))
    posterior, predicted = (
        LogPosterior(fit.posterior.coordinates, fit.model_of(few), few),
        PredictedReadings(fit, few),
    )

    def shown(vector: Float[Tensor, " coordinate"]) -> Tensor:
        return posterior.measured_components(predicted.shown_T(posterior.coordinates.values(vector)))

    if draws is None:
        changing = torch.tensor(_coordinates_of_predictions(fit), device=fit.vector.device)
        directions = Directions.of(fit.rig, posterior.coordinates).only(changing)
        middle_T, along = value_and_jacobian(shown, fit.vector, directions.each)
        slopes = directions.jacobian(along, posterior.sensor)
        variance = _to_first_order(slopes, covariance[changing][:, changing])
        draws = _draws(fit, covariance)
    else:
        with torch.no_grad():
            each_T = torch.stack([shown(vector) for vector in _some(draws, N_SHOWN)])
        middle_T, variance = each_T.mean(0), each_T.var(0)
    with torch.no_grad():
        noise_T = posterior.component_sigma_T(draws)
    return _inside(_mixture(posterior, fit, middle_T, noise_T, variance)[1], 0.9)


def posterior_scores(fit: Fit, calibration: Calibration, unseen: Observations) -> ValidationScores:
    """Scores of a calibrated model as it is handed out: of its best values, and as uncertain as its draws.

    Args:
        fit: Of the same rig.
        calibration: Sampled from readings that the unseen ones are not among.
        unseen: The readings.
    """
    coordinates = fit.posterior.coordinates
    best = coordinates.vector({name: calibration.best[name] for name in coordinates.names})
    draws = {name: torch.from_numpy(calibration.draws[name].reshape(-1)) for name in coordinates.names}
    vectors = coordinates.vector(draws)
    handed_out = Fit(fit.posterior, fit.optimum.at(best))
    return validation_scores(handed_out, unseen, draws=_some(vectors, N_DRAWS))


def _coordinates_of_predictions(fit: Fit) -> list[int]:
    """Numbers of the coordinates that the predicted field depends on: it has no departure of sensors, and those may be hundreds."""
    absent = tuple(f"{c.label}." for c in fit.rig.corrections if not is_in_field(fit.rig, c))
    return [i for i, name in enumerate(fit.posterior.coordinates.names) if not name.startswith(absent)]


def _some(draws: Float[Tensor, "draw coordinate"], n: int) -> Float[Tensor, "some coordinate"]:
    """About so many of the draws, evenly."""
    return draws[:: max(1, len(draws) // n)]


def _to_first_order(
    slopes: Float[Tensor, "component coordinate"], covariance: Float[Tensor, "coordinate coordinate"]
) -> Float[Tensor, " component"]:
    """Variance of what changes so with the coordinates."""
    return ((slopes @ covariance) * slopes).sum(-1)


def _draws(fit: Fit, covariance: Float[Tensor, "coordinate coordinate"]) -> Float[Tensor, "draw coordinate"]:
    """Coordinates that scatter as a covariance says, always the same ones."""
    variances, axes = torch.linalg.eigh(covariance)
    generator = torch.Generator().manual_seed(0)
    normal = torch.randn(N_DRAWS, len(variances), generator=generator, dtype=variances.dtype).to(variances)
    away: Tensor = (normal * variances.clamp(min=0.0).sqrt()) @ axes.T
    return fit.vector + away


def _mixture(
    posterior: LogPosterior,
    fit: Fit,
    middle_T: Float[Tensor, "*draw component"],
    noise_T: Float[Tensor, "draw component"],
    variance: Float[Tensor, " component"],
) -> tuple[Float[Tensor, " component"], Float[Tensor, " component"]]:
    """Log predictive density of each component and the probability below it.

    Where the rig has outliers two normals are mixed, and always those of noise as wide as in each draw.

    Args:
        middle_T, variance: Of the predictions, without noise; of each draw, where it has one of its own.
    """
    residual_T = posterior.measured_T - middle_T
    share, ratio = posterior.contamination(fit.values)
    good, bad = (
        torch.distributions.Normal(0.0, torch.sqrt(width_T**2 + variance))
        for width_T in (noise_T, ratio * noise_T)
    )
    parts = torch.stack(
        (torch.log1p(-share) + good.log_prob(residual_T), torch.log(share) + bad.log_prob(residual_T))
    )
    below = (1.0 - share) * good.cdf(residual_T) + share * bad.cdf(residual_T)
    return torch.logsumexp(parts, (0, 1)) - math.log(len(noise_T)), below.mean(0)
