"""What no cause explains is found in whatever it depends on, and pure noise is not."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
import torch
from torch import Tensor

from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.structure.discrepancy import discrepancy
from estimator.diagnosis.structure.families import families
from estimator.model.nominal import gradient_T_per_m
from tests.estimator.diagnosis.sessions import plain_fit

pytestmark = pytest.mark.whole
VISIBLE = 12.0  # standard deviations beyond what the fit follows

Disturbance = Callable[[Fit], Tensor]


def waves(period_s: float) -> Disturbance:
    def disturbed(fit: Fit) -> Tensor:
        phase = 2.0 * math.pi * fit.observations.time_s / period_s + 0.7
        return torch.sin(phase)[:, None] * torch.tensor([1.0, -0.5, 0.3])

    return disturbed


def spell_of_gain(fit: Fit) -> Tensor:
    order = fit.observations.row
    return ((order > 40) & (order < 90))[:, None] * fit.observations.field_sensor_T


def walk(fit: Fit) -> Tensor:
    steps = np.random.default_rng(3).normal(size=(len(fit.observations), 3))
    return torch.from_numpy(np.cumsum(steps, axis=0))[fit.observations.row]


def remanence(fit: Fit) -> Tensor:
    history = fit.observations.history
    before_A = torch.cat((history.current_A[:1], history.current_A[:-1]))[:, 0][fit.observations.row]
    unit_T = fit.observations.field_sensor_T / fit.observations.current_A
    return before_A[:, None] * unit_T


def current_in_the_reading(fit: Fit) -> Tensor:
    return fit.observations.current_A * torch.tensor([1.0, 0.0, 2.0])


def rectified(fit: Fit) -> Tensor:
    return (fit.observations.current_A < 0.0) * fit.observations.field_sensor_T


def ripple(fit: Fit) -> Tensor:
    phase = 2.0 * math.pi * fit.observations.field_sensor_T / 0.9e-3 + torch.tensor([0.3, 1.9, -2.0])
    return torch.sin(phase)


def coarse_range(fit: Fit) -> Tensor:
    field_T = fit.observations.field_sensor_T
    largest_T = field_T.abs().amax(1)
    return (largest_T > torch.quantile(largest_T, 0.4))[:, None] * field_T


def range_of_each(fit: Fit) -> Tensor:
    field_T = fit.observations.field_sensor_T
    return (field_T.abs() > torch.quantile(field_T.abs(), 0.6, dim=0)) * field_T


def sag(fit: Fit) -> Tensor:
    x_m = fit.observations.motion["arm1"][:, 0]
    return x_m[:, None] ** 2 * fit.observations.field_sensor_T.flip(1)


def lost_steps(fit: Fit) -> Tensor:
    slope_T_per_m = gradient_T_per_m(fit.posterior.model, fit.values, "arm1")
    is_later = fit.observations.row > 60
    return is_later[:, None] * (slope_T_per_m @ torch.tensor([0.4, -0.7, 0.2], dtype=torch.float64))


def shorted_turn(fit: Fit) -> Tensor:
    return (fit.observations.row > 60)[:, None] * fit.observations.field_sensor_T


DISTURBANCES = {
    "slow wave": (waves(130.0), "in time"),
    "wave near two readings": (waves(4.7), "in time"),
    "wave seen at its alias": (waves(1.43), "in time"),
    "spell of another gain": (spell_of_gain, "spell"),
    "random walk": (walk, "time"),
    "remanence": (remanence, "before"),
    "current in the reading": (current_in_the_reading, "current"),
    "current in one direction": (rectified, "current"),
    "ripple of the converter": (ripple, "ripple"),
    "coarse range": (coarse_range, "range of a sensor"),
    "range of each component": (range_of_each, "range of a sensor"),
    "sag": (sag, ""),
    "lost steps": (lost_steps, "change of coil, mover or room in mid session, arm1"),
    "shorted turn": (shorted_turn, "change of coil, mover or room in mid session, coil1"),
}


@pytest.mark.parametrize("name", DISTURBANCES)
def test_what_is_visible_at_twelve_sigma_is_found_where_it_lies(name: str):
    disturbance, words = DISTURBANCES[name]
    fit = plain_fit()
    change_T = disturbance(fit)
    whitened = fit.posterior.measured_components(change_T) * fit.whitening_per_T
    change_T = change_T * VISIBLE / fit.projector.rest(whitened).norm()
    readings = fit.observations.with_field(fit.observations.field_sensor_T + change_T)
    disturbed = fit_rig(fit.rig, readings, fit.values, fit.posterior.model.rules)
    left = discrepancy(disturbed, families(disturbed))
    assert left.log_bayes_factor > 5.0
    assert words in left.family


@pytest.mark.parametrize("seed", [11, 12, 13])
def test_noise_is_nothing(seed: int):
    fit = plain_fit(seed=seed)
    assert discrepancy(fit, families(fit)).log_bayes_factor < 0.0


def test_evidence_of_many_families_at_once_is_that_of_each_alone():
    """By the definition of the evidence: the ratio of normal densities of the residual with and without the columns."""
    fit = plain_fit()
    some = families(fit)[::97]
    together = discrepancy(fit, some)
    for family in some[:3]:
        alone = discrepancy(fit, [family])
        assert alone.log_bayes_factor == pytest.approx(alone.by_family[family.name], abs=1e-9)
    names = {family.name for family in some}
    assert set(together.by_family) == names
