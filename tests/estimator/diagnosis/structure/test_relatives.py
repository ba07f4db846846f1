"""A small effect may be something that only resembles its cause; a large one that is cleanly explained may not."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.structure.families import families
from estimator.diagnosis.structure.relatives import Unknown, unknown_beside, visible_rms_sigma
from estimator.diagnosis.verdict import NamedCause
from estimator.effects.attach import with_effect
from estimator.rig.rig import Cause
from tests.estimator.diagnosis.sessions import TRUTH, plain_fit
from tests.estimator.diagnosis.small_fits import with_wrong

pytestmark = pytest.mark.whole
GAIN = Cause("axis_gain", "hall")


def fit_with_gain(excess: float, relative: float = 0.0) -> Fit:
    """The gain of the x axis is off, and beside it the reading bends by that share of the effect."""
    base = plain_fit()
    readings = with_wrong(base.rig.with_values(TRUTH), base.observations, GAIN, {"x": excess})
    x_T = base.observations.field_sensor_T[:, 0]
    bend_T = relative * excess * x_T * torch.sign(x_T)
    readings = readings.with_field(
        readings.field_sensor_T + torch.stack((bend_T, 0.0 * x_T, 0.0 * x_T), dim=1)
    )
    rig = with_effect(base.rig, GAIN, readings, {})
    return fit_rig(rig, readings, base.start_with(rig), base.posterior.model.rules)


def unknown(fit: Fit) -> Unknown:
    return unknown_beside(fit, [GAIN], families(fit))[0]


def p_outside(fit: Fit) -> float:
    return unknown(fit).probability


def test_the_larger_a_clean_effect_the_less_is_left_to_its_relatives():
    small, middle, large = (p_outside(fit_with_gain(excess)) for excess in (0.003, 0.01, 0.05))
    assert 0.1 < small < 0.5
    assert small > middle > large
    assert large < policy.LEAST_BESIDE_A_NAME


def test_a_relative_that_leaves_a_trace_is_noticed():
    assert p_outside(fit_with_gain(0.05, relative=0.5)) > 0.9


def test_a_large_name_does_not_bear_what_a_small_one_may() -> None:
    """A bend of an eighth of an effect of 52 standard deviations leaves 9 %, where noise would leave far less."""
    large = unknown(fit_with_gain(0.03, relative=0.12))
    assert policy.LEAST_BESIDE_A_NAME <= large.most_beside < 0.07
    assert large.most_beside < large.probability < policy.MOST_BESIDE_A_NAME
    named = NamedCause(GAIN, 0.9, (), 50.0, large.probability, large.most_beside)
    assert named.may_be_unknown
    assert not replace(named, most_beside=policy.MOST_BESIDE_A_NAME).may_be_unknown


def test_visible_size_is_the_root_of_the_likelihood_ratio():
    """For a linear effect: twice the log likelihood that is lost without it, but for the noise."""
    fit = fit_with_gain(0.02)
    without = fit_rig(fit.rig.without_cause(GAIN), fit.observations, fit.values, fit.posterior.model.rules)
    sigma2 = float(
        (without.residual * without.values["hall.noise_T"] / fit.values["hall.noise_T"]).square().sum()
        - fit.residual.square().sum()
    )
    assert visible_rms_sigma(fit, GAIN) ** 2 * len(fit.residual) == pytest.approx(sigma2, rel=0.1)
