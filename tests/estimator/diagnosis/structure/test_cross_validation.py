"""Blocks predicted from all others without a further fit, against fits without them."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.structure.cross_validation import (
    HeldOut,
    held_out,
    jackknife_covariance,
    log_predictive,
)
from estimator.diagnosis.validation import validation_scores
from estimator.readings.split import pose_blocks
from estimator.rig.rig import Cause, Rig
from estimator.store.session import Session
from tests.estimator.diagnosis.small_fits import fit_of, with_wrong

GAIN, OFFSET = Cause("axis_gain", "hall"), Cause("sensor_offset", "hall")


@pytest.fixture(scope="module")
def fit(small_rig: Rig, small_session: Session) -> Fit:
    return fit_of(small_rig, small_session.observations)


@pytest.fixture(scope="module")
def block(small_session: Session) -> np.ndarray:
    return pose_blocks(small_session.observations, np.random.default_rng(0))


def test_each_block_is_predicted_as_a_fit_of_the_others_predicts_it(fit, block):
    quick = log_predictive(fit, block)
    numbers = np.unique(block)
    for number in numbers[:3]:
        others = fit.observations.rows(torch.from_numpy(block != number))
        mine = fit.observations.rows(torch.from_numpy(block == number))
        again = fit_rig(fit.rig, others, fit.values, fit.posterior.model.rules)
        # The fit again has its own noise, and takes the readings of a block as independent of each other.
        n = 3 * len(mine)
        assert float(quick[numbers.tolist().index(number)]) == pytest.approx(
            validation_scores(again, mine).elpd, abs=0.05 * n
        )


def test_density_is_that_of_a_linear_fit_of_the_other_blocks(fit, block):
    quick = log_predictive(fit, block)
    own_block = torch.from_numpy(np.repeat(block, 3))
    for i, number in enumerate(np.unique(block)):
        mine = own_block == number
        slope, residual = fit.jacobian[mine], fit.residual[mine]
        precision = fit.optimum.precision[0] - slope.T @ slope
        step = -torch.linalg.solve(precision, slope.T @ residual)
        spread = torch.eye(len(residual)).double() + slope @ torch.linalg.solve(precision, slope.T)
        normal = torch.distributions.MultivariateNormal(slope @ step, spread)
        expected = normal.log_prob(residual) + torch.log(fit.whitening_per_T[mine]).sum()
        assert float(quick[i]) == pytest.approx(float(expected), abs=1e-6)


def test_scatter_is_that_of_linear_fits_without_one_block_after_another(fit, block):
    own_block = torch.from_numpy(np.repeat(block, 3))
    moves = []
    for number in np.unique(block):
        mine = own_block == number
        slope = fit.jacobian[mine]
        moves.append(
            torch.linalg.solve(fit.optimum.precision[0] - slope.T @ slope, slope.T @ fit.residual[mine])
        )
    moved = torch.stack(moves)
    expected = (1.0 - 1.0 / len(moved)) * moved.T @ moved
    result = jackknife_covariance(fit, block)
    sd = torch.sqrt(torch.diagonal(expected))
    torch.testing.assert_close(result / sd / sd[:, None], expected / sd / sd[:, None], rtol=1e-6, atol=1e-6)


def test_scatter_of_blocks_is_the_standard_deviation_where_noise_is_independent(fit, block):
    """Over many draws of the noise, in the linear model about the fit."""
    generator = torch.Generator().manual_seed(4)
    ratios = []
    for _ in range(60):
        noise = torch.randn(len(fit.residual), generator=generator, dtype=torch.float64)
        noisy = fit.to_first_order(fit.projector, fit.projector.rest(noise))
        jackknife_variance = torch.diagonal(jackknife_covariance(noisy, block))
        ratios.append(torch.sqrt(jackknife_variance / torch.diagonal(fit.covariance)))
    determined = torch.diagonal(fit.projector.gram(fit.jacobian, fit.jacobian)) < 0.05 * torch.diagonal(
        fit.optimum.information[0]
    )
    mean = torch.stack(ratios).mean(0)[determined]
    assert len(mean) >= 3
    assert (mean > 0.85).all()
    assert (mean < 1.3).all()


def test_cause_in_the_readings_gains_on_unseen_blocks_and_one_that_is_not_does_not(
    small_rig: Rig, small_session: Session, block
):
    readings = with_wrong(small_rig, small_session.observations, OFFSET, {"x_T": 100e-6, "z_T": -150e-6})
    plain, right = fit_of(small_rig, readings), fit_of(small_rig, readings, OFFSET)
    result = held_out(plain, right, block)
    assert result.elpd_difference > 2.0 * result.elpd_se > 0.0
    beyond = held_out(right, fit_of(small_rig, readings, OFFSET, GAIN), block)
    assert beyond.elpd_difference < 2.0 * max(beyond.elpd_se, 1.0)


def test_loss_is_one_that_exceeds_its_error():
    assert HeldOut(-5.0, 2.0).is_loss
    assert not HeldOut(-3.0, 2.0).is_loss
    assert not HeldOut(-3.0, math.inf).is_loss
