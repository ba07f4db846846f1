"""The calibration that would replace the current one, and what a diagnosis gives to a conclusion."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.calibration.calibrate import calibrate
from estimator.calibration.result import Calibration
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.result import Diagnosis
from estimator.effects import EFFECTS
from estimator.effects.base import WHEN
from estimator.inference.ensemble import SamplerSettings
from estimator.readings.observations import Observations
from estimator.recalibration import policy
from estimator.recalibration.agreement import at_stored_draws
from estimator.recalibration.watcher import UNWATCHED, Watcher
from estimator.rig.rig import Rig
from estimator.store.session import Session


def sampled_successor(
    session: Session,
    diagnosis: Diagnosis,
    seed: int,
    settings: SamplerSettings | None,
    watcher: Watcher = UNWATCHED,
) -> Calibration:
    """Sample the extended rig of a diagnosis as far as it lasts; causes may need more walkers than were asked for."""
    rig = lasting(diagnosis.extended_rig)
    if settings is not None and settings.n_walkers:
        n = len(rig.free)
        settings = replace(settings, n_walkers=max(settings.n_walkers, 2 * n, n + 2))
    watcher.on_words("sampling a new version")
    return calibrate(
        session, rig, seed=seed, settings=settings, as_described=True, on_stage=watcher.on_sampling
    )


def lasting(rig: Rig) -> Rig:
    """The rig without corrections that are functions of the time in one session: in the next one they would correct what is not there."""
    for correction in rig.corrections:
        if EFFECTS[correction.name].beyond_the_moment("") == WHEN:
            rig = rig.without_cause(correction)
    return rig


def short_of(calibration: Calibration) -> str:
    """How sampling fell short of its targets, in words."""
    sampling = calibration.summary()["sampling"]
    rhat = sampling["largest_rhat"]
    numbers = f"{sampling['smallest_ess']:.0f} effective samples, R-hat {'unknown' if rhat is None else f'{rhat:.3f}'}"
    return f"its posterior did not converge ({numbers})"


def is_unexplained(diagnosis: Diagnosis) -> bool:
    """Whether the residual exceeds noise, in structure or in size."""
    if diagnosis.verdict.leaves_something:
        return True
    return diagnosis.fits.after.lack_of_fit.p_value < policy.FALSE_ALARMS


def causes_of(diagnosis: Diagnosis) -> tuple[Mapping[str, Any], ...]:
    """Causes as in the log and `diagnosis.json`."""
    return tuple(cause.to_json() for cause in diagnosis.sized_causes)


def estimate_of(fit: Fit) -> dict[str, tuple[float, float]]:
    """Value and standard deviation of every free parameter."""
    return {
        parameter.name: (float(fit.values[parameter.name]), fit.value_sd(parameter.name))
        for parameter in fit.rig.free
    }


def stored_log_density(calibration: Calibration, unseen: Observations) -> Float[Tensor, " reading"]:
    """Log predictive density of each reading: the logarithm of the mean density over posterior draws.

    Args:
        calibration: Calibration from other readings.
        unseen: Readings of the same rig; the calibration may have additional effects.
    References: Vehtari, Gelman and Gabry, Statistics and Computing 27, 1413 (2017), eq 3.
    """
    posterior, vectors = at_stored_draws(calibration, unseen)
    with torch.no_grad():
        by_component = posterior.component_log_density(vectors)
    reading = torch.arange(len(unseen))[:, None].expand(-1, 3)[unseen.is_measured]
    by_reading = by_component.new_zeros(len(vectors), len(unseen)).index_add(1, reading, by_component)
    return torch.logsumexp(by_reading, 0) - math.log(len(vectors))
