"""What an extension is worth, on readings that were not used for fitting."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit
from estimator.inference.likelihood import LogPosterior
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.metrics import ErrorMetrics, error_metrics
from estimator.readings.observations import Observations


@dataclass(frozen=True)
class Judged:
    """How well one fit predicts readings that it has not seen.

    Attributes:
        errors: Of the predictions.
        elpd: Expected log predictive density, summed over the readings.
        coverage50, coverage90: Share of the components inside those intervals.
        log_density: Log predictive density reading by reading.
    """

    errors: ErrorMetrics
    elpd: float
    coverage50: float
    coverage90: float
    log_density: Float[Tensor, " reading"]

    def to_json(self) -> dict[str, Any]:
        """As JSON holds it; None stands for what does not apply, such as angles where one component was measured."""
        numbers = {
            **asdict(self.errors),
            "coverage50": self.coverage50,
            "coverage90": self.coverage90,
            "elpd": self.elpd,
        }
        return {name: value if math.isfinite(value) else None for name, value in numbers.items()}


@dataclass(frozen=True)
class Gain:
    """Before and after the extension.

    Attributes:
        elpd_difference, elpd_se: Gain in expected log predictive density and its standard error over readings.
        moved_sd: How far each parameter of the rig moved, in standard deviations of the fit before.
    """

    before: Judged
    after: Judged
    elpd_difference: float
    elpd_se: float
    moved_sd: dict[str, float]

    @property
    def is_there(self) -> bool:
        """Whether the gain exceeds what chance leaves."""
        return self.elpd_difference > policy.LEAST_GAIN_SE * self.elpd_se

    @property
    def is_loss(self) -> bool:
        """Whether a loss exceeds what chance leaves."""
        return self.elpd_difference < -policy.LEAST_LOSS_SE * self.elpd_se


def gain(before: Fit, after: Fit, unseen: Observations) -> Gain:
    """Judge two fits on readings that neither has seen."""
    one, two = judged(before, unseen), judged(after, unseen)
    difference = two.log_density - one.log_density
    n = len(difference)
    se = float(difference.std() * math.sqrt(n)) if n > 1 else math.nan
    moved = {}
    for name in before.posterior.coordinates.names:
        old, new = (fit.values[name] for fit in (before, after))
        moved[name] = float(new - old) / before.value_sd(name)
    return Gain(one, two, float(difference.sum()), se, moved)


def judged(fit: Fit, unseen: Observations) -> Judged:
    """Predictive errors, density and coverage, with the uncertainty of the parameters by Laplace."""
    model = MeasurementModel.unruled(fit.rig, unseen).with_rules(fit.posterior.model.rules)
    posterior = LogPosterior(fit.posterior.coordinates, model, unseen)
    with torch.no_grad():
        predicted_T = model.predict(fit.values).expand(len(unseen), 3)
        mean_T = posterior.measured_components(predicted_T)
        noise_T = posterior.component_sigma_T(fit.vector)
        slope: Tensor = posterior.slope(fit.vector)
    spread2 = ((slope @ fit.covariance) * slope).sum(-1)
    off_T = posterior.measured_T - mean_T
    log_density, below = _mixture(posterior, fit, off_T, noise_T, spread2)
    reading = torch.arange(len(unseen))[:, None].expand(-1, 3)[unseen.is_measured]
    by_reading = torch.zeros(len(unseen), dtype=off_T.dtype).index_add(0, reading, log_density)
    inside = {p: float(((below - 0.5).abs() <= 0.5 * p).double().mean()) for p in (0.5, 0.9)}
    found = error_metrics(unseen.field_sensor_T.numpy(), predicted_T.numpy())
    return Judged(found, float(by_reading.sum()), inside[0.5], inside[0.9], by_reading)


def _mixture(
    posterior: LogPosterior, fit: Fit, off_T: Tensor, noise_T: Tensor, spread2: Tensor
) -> tuple[Tensor, Tensor]:
    """Log predictive density of each component and the probability below it: normal, with wide wings where the rig has them."""
    share, ratio = posterior.contamination(fit.values)
    good, bad = (
        torch.distributions.Normal(0.0, torch.sqrt(width_T**2 + spread2))
        for width_T in (noise_T, ratio * noise_T)
    )
    parts = torch.stack((torch.log1p(-share) + good.log_prob(off_T), torch.log(share) + bad.log_prob(off_T)))
    return torch.logsumexp(parts, 0), (1.0 - share) * good.cdf(off_T) + share * bad.cdf(off_T)
