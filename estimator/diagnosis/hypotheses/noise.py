"""Causes that change the scatter of readings: residuals hint at them, full fits give their evidence."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.diagnosis import effort
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.effects import EFFECTS
from estimator.effects.attach import with_effect
from estimator.effects.base import Kind
from estimator.effects.stages import NoiseEffect, NoiseEstimate
from estimator.effects.use import Use
from estimator.model.nominal import NominalPrediction
from estimator.rig.rig import Cause
from estimator.side_by_side import each

# Log likelihood that a cause of scatter must gain at the residuals to be fitted: it needs 7 or so to be taken
LEAST_SCATTER_GAIN = 4.0


def noise_causes(fit: Fit) -> list[tuple[Cause, float, Fit]]:
    """For each noise effect with a hint the place with the strongest one: its cause, log Bayes factor and fit.

    Args:
        fit: Without them.
    """

    def asked(effect: NoiseEffect) -> tuple[Cause, float, Fit] | None:
        circumstances = fit.circumstances
        uses = [Use(effect, p) for p in effect.places(fit.rig) if effect.concerns(circumstances, p)]
        hints = [(_hint(fit, use), use) for use in uses if use.cause not in fit.rig.effects]
        hint, use = max(hints, key=lambda pair: pair[0], default=(0.0, None))
        if use is None or hint <= LEAST_SCATTER_GAIN:
            return None
        return (use.cause, *_fitted(fit, use))

    effects = [effect for effect in EFFECTS.values() if isinstance(effect, NoiseEffect)]
    return [row for row in each(asked, effects) if row is not None]


def _hint(fit: Fit, use: Use[NoiseEffect]) -> float:
    """Rise in log likelihood at the present residuals."""
    estimate = use.effect.estimate(_concerned(fit, use, fit.residual))
    return _score(fit, use) if estimate is None else estimate.log_likelihood_improvement


def _score(fit: Fit, use: Use[NoiseEffect]) -> float:
    """Rise in log likelihood, to second order, by the variance that the effect adds: half the square of the score statistic."""
    exposure = use.effect.exposure(NominalPrediction(fit.posterior.model), use.place)
    exposure, sigma_T, whitening_per_T, residual = (
        _concerned(fit, use, components)
        for components in (
            fit.posterior.measured_components(exposure),
            fit.posterior.component_sigma_T(fit.vector),
            fit.whitening_per_T,
            fit.residual,
        )
    )
    quantities = use.effect.quantities(fit.circumstances.extent)
    typical = {q.key: fit.vector.new_tensor(q.prior.centre) for q in quantities}
    added = (use.effect.sigma_T(sigma_T, exposure, typical) ** 2 - sigma_T**2) * whitening_per_T**2
    added = added - added.mean()
    excess = residual**2 - residual.square().mean()
    score = float((added * excess).sum() / torch.sqrt(2.0 * (added**2).sum()).clamp(min=1e-300))
    return 0.5 * max(score, 0.0) ** 2


def _concerned(
    fit: Fit, use: Use[NoiseEffect], components: Float[Tensor, " component"]
) -> Float[Tensor, " concerned"]:
    """Components of the readings that a noise effect concerns."""
    readings = use.concerned(fit.circumstances)
    if readings is None:
        return components
    return components[fit.posterior.measured_components(readings[:, None].expand(-1, 3))]


def _fitted(fit: Fit, use: Use[NoiseEffect]) -> tuple[float, Fit]:
    """Log Bayes factor and fit with the effect, which starts from its estimate by the residuals."""
    whitened = _concerned(fit, use, fit.residual)
    estimate = use.effect.estimate(whitened) or NoiseEstimate({}, 1.0, 0.0)
    rig = with_effect(fit.rig, use.cause, fit.observations, estimate.quantities)
    start = fit.start_with(rig)
    if use.effect.kind is Kind.SENSOR:
        noise = f"{use.place}.noise_T"
        start[noise] = fit.values[noise] * estimate.noise_factor
    rules = fit.posterior.model.rules
    full = fit_rig(
        rig,
        fit.observations,
        start,
        rules,
        tolerance=effort.ROUGH_TOLERANCE,
        near=fit,
    )
    if not full.still_has(use.cause):
        return 0.0, full
    # Each quantity that is estimated and not fitted costs half the log of the sample size, as in BIC.
    n_fixed = sum(not rig.parameters[f"{use.label}.{key}"].is_free for key in estimate.quantities)
    occam = 0.5 * n_fixed * math.log(max(len(whitened), 1))
    return full.log_evidence - fit.log_evidence - occam, full
