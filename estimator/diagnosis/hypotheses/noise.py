"""Causes that change how readings scatter: outliers, and a mover that misses its targets. Their evidence comes from full fits."""

from __future__ import annotations

import math
from collections.abc import Iterator

import torch
from torch import Tensor

from estimator.diagnosis.fitting import ROUGH, Fit, fit_rig
from estimator.effects import EFFECTS
from estimator.effects.attach import with_effect
from estimator.effects.base import NoiseEffect
from estimator.rig.rig import Cause

LEAST_GAIN = 4.0  # in log likelihood at the residuals as they are, for a full fit
EM_STEPS = 60
FEWEST = 10  # components of a sensor, for a share of them to mean anything
RATIOS = (4.0, 10.0, 25.0)  # scatter of outliers to begin with, in units of the noise


def noise_causes(fit: Fit, beside: float) -> Iterator[tuple[Cause, float, Fit | None]]:
    """The causes of scatter that the residuals hint at most, with log Bayes factor and fit: of each kind the one place that gains most.

    Args:
        fit: Without them.
        beside: Log Bayes factor from which on a hint is worth a full fit; below, the hint stands for the evidence.
    """
    for name, effect in EFFECTS.items():
        if isinstance(effect, NoiseEffect):
            places = [Cause(name, place) for place in effect.places(fit.rig)]
            hints = [(_hint(fit, cause), cause) for cause in places if cause not in fit.rig.effects]
            gain, cause = max(hints, key=lambda pair: pair[0], default=(0.0, None))
            if cause is None or gain <= LEAST_GAIN:
                continue
            if gain < beside:
                yield cause, gain, None
            else:
                yield cause, *(_outliers(fit, cause) if name == "outliers" else _jitter(fit, cause))


def _hint(fit: Fit, cause: Cause) -> float:
    """Gain in log likelihood at the residuals as they are."""
    if cause.name == "outliers":
        z = _own_residual(fit, cause)
        return max(_mixture(z, start)[3] for start in RATIOS) if len(z) > FEWEST else 0.0
    gradient = fit.posterior.model.gradient_T_per_m(cause.place).norm(dim=-1)
    steepness = fit.posterior.measured_components(gradient) * fit.whitening_per_T
    steep2 = steepness**2 - (steepness**2).mean()
    excess = fit.residual**2 - fit.residual.square().mean()
    score = float((steep2 * excess).sum() / torch.sqrt(2.0 * (steep2**2).sum()).clamp(min=1e-300))
    return 0.5 * max(score, 0.0) ** 2


def _own_residual(fit: Fit, cause: Cause) -> Tensor:
    return fit.residual[fit.posterior.sensor == [s.name for s in fit.rig.sensors].index(cause.place)]


def _outliers(fit: Fit, cause: Cause) -> tuple[float, Fit]:
    """Share and scatter of outliers by expectation and maximisation, then everything else fitted with them."""
    z = _own_residual(fit, cause)
    share, ratio, shrink, _ = max((_mixture(z, start) for start in RATIOS), key=lambda found: found[3])
    rig = with_effect(fit.rig, cause, fit.observations, {"share": share, "ratio": ratio / shrink})
    noise = f"{cause.place}.noise_T"
    start = {**fit.start_with(rig), noise: fit.values[noise] * shrink}
    full = fit_rig(rig, fit.observations, start, fit.posterior.model.rules, tolerance=ROUGH)
    return full.log_evidence - fit.log_evidence - math.log(
        len(z)
    ), full  # two numbers at half a logarithm each


def _jitter(fit: Fit, cause: Cause) -> tuple[float, Fit]:
    """Everything fitted with a mover that scatters."""
    rig = with_effect(fit.rig, cause, fit.observations, {})
    full = fit_rig(rig, fit.observations, fit.start_with(rig), fit.posterior.model.rules, tolerance=ROUGH)
    return full.log_evidence - fit.log_evidence, full


def _mixture(z: Tensor, ratio: float) -> tuple[float, float, float, float]:
    """Share, wide and narrow scatter of a mixture of two normal distributions about zero, and its gain over one."""
    share, narrow, wide = 0.05, 0.8 * float(z.square().mean().sqrt()), ratio
    normal_gain = 0.0
    for _ in range(EM_STEPS):
        good = math.log1p(-share) - 0.5 * (z / narrow) ** 2 - math.log(narrow)
        bad = math.log(share) - 0.5 * (z / wide) ** 2 - math.log(wide)
        mixed = torch.logaddexp(good, bad)
        normal_gain = float(mixed.sum())
        is_bad = torch.exp(bad - mixed)
        share = min(max(float(is_bad.mean()), 1e-4), 0.4)
        narrow = max(float(((1.0 - is_bad) * z**2).sum() / (1.0 - is_bad).sum()) ** 0.5, 1e-3)
        wide = max(float((is_bad * z**2).sum() / is_bad.sum().clamp(min=1e-9)) ** 0.5, 2.0 * narrow)
    rms = float(z.square().mean().sqrt())
    one_normal = -0.5 * len(z) - len(z) * math.log(rms)
    return share, wide, narrow, normal_gain - one_normal
