"""Discrete mistakes of the record, before anything is fitted finely: axes, signs, units, frames of displacements.

Each makes the readings absurd unless undone. All starts of all of them are compared at once on a few readings, at the nominal rig with its
parameters let go to first order; the best few are fitted. A session whose noise is as expected has none of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.func import jacfwd

from estimator.chain import Chain
from estimator.coordinates import Coordinates
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.effects import EFFECTS
from estimator.effects.attach import with_effect
from estimator.effects.record import RECORD
from estimator.inference.likelihood import LogPosterior
from estimator.records import Observations
from estimator.rig import Cause, Rig

MOST_FITS = 6
MOST_FAULTS = 3
MOST_READINGS = 100  # for the comparison of all starts
MOST_LOST_ON_FEW = 3.0  # log evidence on these, against no mistake, of one that is worth a fit to all
LOG_PRIOR_FAULT = math.log(1e-3)
EXPECTED_NOISE, EXPECTED_VALUE = (
    2.5,
    3.5,
)  # standard deviations of the prior within which what is fitted must lie
LARGEST_MEAN_SQUARE = 1.5  # of whitened residuals
TWINS_WITHIN = 3.0  # of the best in log evidence: they explain the readings as well
LEAST_LOG_GAIN = math.log(1e3)


@dataclass(frozen=True)
class Fault:
    """A mistake of the record.

    Attributes:
        cause: The one that was undone.
        log_bayes_factor: Against no mistake.
        twins: Others that would explain the readings as well, with the difference in log evidence.
    """

    cause: Cause
    log_bayes_factor: float
    twins: tuple[tuple[Cause, float], ...]


def without_faults(base: Fit) -> tuple[Fit, list[Fault]]:
    """Undo mistakes of the record one after another while the evidence asks for it.

    Returns: The fit with the mistakes as effects of its rig, and what was found.
    """
    found: list[Fault] = []
    while len(found) < MOST_FAULTS and not _is_as_expected(base):
        fits = sorted(_faults(base), key=lambda fit: -fit.log_evidence)
        if not fits or fits[0].log_evidence - base.log_evidence < LEAST_LOG_GAIN - LOG_PRIOR_FAULT:
            break
        best = fits[0]
        others = [(fit.rig.effects[-1], fit.log_evidence - best.log_evidence) for fit in fits[1:]]
        twins = {
            cause: value
            for cause, value in reversed(others)
            if value > -TWINS_WITHIN and cause != best.rig.effects[-1]
        }
        gain = best.log_evidence - base.log_evidence
        found.append(Fault(best.rig.effects[-1], gain, tuple(twins.items())))
        base = best
    return base, found


def _is_as_expected(fit: Fit) -> bool:
    """Whether the readings are followed down to a noise that was expected, by parameters that were expected."""
    if float(fit.residual.square().mean()) > LARGEST_MEAN_SQUARE:
        return False
    noises = {f"{sensor.name}.noise_T" for sensor in fit.rig.sensors}
    for parameter in fit.rig.free:
        assert parameter.prior is not None
        distance = abs(parameter.prior.distance(float(fit.values[parameter.name])))
        if distance > (EXPECTED_NOISE if parameter.name in noises else EXPECTED_VALUE):
            return False
    return True


def _faults(base: Fit) -> list[Fit]:
    """Full fits of the mistakes that look best on a few readings, and follow those no worse than the rig as it is."""
    scene = base.posterior.chain.scene
    observations = scene.observations
    some = torch.linspace(0, len(observations) - 1, min(MOST_READINGS, len(observations))).round().long()
    few = observations.rows(some.unique())
    present = {cause.name for cause in base.rig.effects}
    ranked = [
        (_coarse(rig, base, few), rig)
        for name in RECORD
        if name not in present
        for place in EFFECTS[name].places(base.rig)
        for shapes in EFFECTS[name].starts(scene, place)
        if (rig := with_effect(base.rig, Cause(name, place), observations, shapes))
    ]
    ranked.sort(key=lambda pair: -pair[0])
    rules = base.posterior.chain.rules
    least = fit_rig(base.rig, few, base.values, rules).log_evidence - MOST_LOST_ON_FEW
    trials = [fit_rig(rig, few, rig.nominal_values(), rules) for _, rig in ranked[:MOST_FITS]]
    better = [
        trial for trial in trials if trial.still_has(trial.rig.effects[-1]) and trial.log_evidence > least
    ]
    fits = [fit_rig(trial.rig, observations, trial.values, rules) for trial in better]
    return [fit for fit in fits if fit.still_has(fit.rig.effects[-1])]


def _coarse(rig: Rig, base: Fit, observations: Observations) -> float:
    """Log likelihood at the best common noise, after the parameters were let go to first order from the nominal rig within their priors."""
    chain = replace(Chain.unruled(rig, observations), rules=base.posterior.chain.rules)
    posterior = LogPosterior(Coordinates(rig), chain, observations)
    vector = posterior.coordinates.start()
    unit = float(posterior.component_sigma_T(vector).mean() / posterior.sigma_T(vector).mean())
    with torch.no_grad():
        residual = (posterior.measured_T - posterior.predicted(vector)) / unit
        slope: Tensor = jacfwd(posterior.for_slopes.predicted)(vector) / unit * posterior.coordinates.scale
    prior = torch.eye(len(vector), dtype=torch.float64)
    noise_T = float(residual.square().mean().sqrt())
    step = torch.zeros_like(vector)
    for _ in range(2):  # the noise of the first step is that of the absurd readings
        weighted = slope / noise_T
        step = torch.linalg.solve(weighted.T @ weighted + prior, weighted.T @ residual / noise_T)
        noise_T = max(float((residual - slope @ step).square().mean().sqrt()), 1e-9)
    return -len(residual) * math.log(noise_T * unit) - 0.5 * float(step.square().sum())
