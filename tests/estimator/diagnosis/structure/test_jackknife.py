"""Scatter of a fit that misses one block of readings after another, without a further fit, against fits without them."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.structure.jackknife import jackknife_covariance
from estimator.readings.split import pose_blocks
from estimator.rig.rig import Rig
from estimator.store.session import Session
from tests.estimator.diagnosis.small_fits import fit_of


@pytest.fixture(scope="module")
def fit(small_rig: Rig, small_session: Session) -> Fit:
    return fit_of(small_rig, small_session.observations)


@pytest.fixture(scope="module")
def block(small_session: Session) -> np.ndarray:
    return pose_blocks(small_session.observations, np.random.default_rng(0))


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
