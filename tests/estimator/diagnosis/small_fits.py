"""Fits of the small rig of tests/estimator, with and without causes, a fraction of a second each."""

from __future__ import annotations

from collections.abc import Mapping

import torch

from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.limits import Limits
from estimator.diagnosis.mixture.answer import Answer
from estimator.diagnosis.mixture.confirmed import answer
from estimator.effects.attach import with_effect
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.rig.rig import Cause, Rig

OFFSET_T = 2e-4  # of the zero of a sensor


def fit_of(rig: Rig, observations: Observations, *causes: Cause) -> Fit:
    """Fit of the rig with some causes."""
    fit = fit_rig(rig, observations, {}, MeasurementModel.build(rig, observations).rules)
    for cause in causes:
        wider = with_effect(fit.rig, cause, observations, {})
        fit = fit_rig(wider, observations, fit.start_with(wider), fit.posterior.model.rules)
    return fit


def answered(fit: Fit, n_pairs: int = 1) -> Answer:
    """What the readings of a fit say is wrong."""
    return answer(fit, Limits(), seed=1, n_pairs=n_pairs)


def unheard(words: str) -> None:
    """Stages, which no test reads."""


def with_wrong(
    rig: Rig, observations: Observations, cause: Cause, given: Mapping[str, float]
) -> Observations:
    """The readings with the change that a cause makes at the truth."""
    wrong = with_effect(rig, cause, observations, {}, is_free=False).with_values(
        {f"{cause.label}.{key}": value for key, value in given.items()}
    )
    before, after = (predicted_T(r, observations) for r in (rig, wrong))
    return observations.with_field(observations.field_sensor_T + after - before)


def predicted_T(rig: Rig, observations: Observations) -> torch.Tensor:
    """Predictions of a rig at its nominal values."""
    values = {name: torch.tensor(v, dtype=torch.float64) for name, v in rig.nominal_values().items()}
    return MeasurementModel.build(rig, observations).predict(values).expand(len(observations), 3)
