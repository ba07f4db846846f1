"""Intervals hold the truth where a curve that no cause explains is in the readings too."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from estimator.diagnosis.cross_validation import jackknife_covariance
from estimator.diagnosis.discrepancy import Discrepancy, discrepancy, families
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.widening import widening
from estimator.metrics import HALF_WIDTH_90
from estimator.rig import Rig
from estimator.split import blocks_of_places
from estimator.store.session import Session
from tests.estimator.diagnosis.small_fits import fit_of


@pytest.fixture(scope="module")
def fit(small_rig: Rig, small_session: Session) -> Fit:
    return fit_of(small_rig, small_session.observations)


def test_blocks_know_of_curves_that_the_noise_does_not(fit):
    """Over many draws of curve and noise, in the linear model about the fit; a block must not be smaller than what varies in it."""
    curves = [f for f in families(fit) if f.name == "place relative to coil1, with its current"]
    generator = torch.Generator().manual_seed(13)
    block = blocks_of_places(fit.observations, np.random.default_rng(0))
    by_noise, by_block = [], []
    sd = torch.sqrt(torch.diagonal(fit.covariance))
    for i in range(600):
        columns = 2.0 * curves[i % len(curves)].columns
        readings = torch.randn(len(columns), generator=generator, dtype=torch.float64)
        readings += columns @ torch.randn(columns.shape[1], generator=generator, dtype=torch.float64)
        off = (fit.covariance @ (fit.jacobian.T @ readings)).abs()
        seen = fit.to_first_order(fit.projector, fit.projector.rest(readings))
        scatter = torch.sqrt(torch.diagonal(jackknife_covariance(seen, block)))
        by_noise.append(off < HALF_WIDTH_90 * sd)
        by_block.append(off < HALF_WIDTH_90 * torch.maximum(scatter, sd))
    assert (torch.stack(by_noise).double().mean(0) < 0.6).all()
    assert (torch.stack(by_block).double().mean(0) > 0.75).all()


def test_more_readings_make_nothing_surer_of_what_a_curve_leaves_open(small_rig, small_session):
    observations = small_session.observations
    searched, many = fit_of(small_rig, observations.calibration), fit_of(small_rig, observations)
    columns = 5.0 * families(searched)[0].columns
    left = Discrepancy(30.0, "a curve", {}, 5.0, columns)
    beside = searched.covariance_beside(columns)
    for name, factor in widening(searched, many, left).items():
        assert factor * many.value_sd(name) >= searched.value_sd(name, beside) * (1.0 - 1e-12)
        assert factor > 1.0


def test_nothing_is_made_surer(fit):
    left = discrepancy(fit, families(fit))
    factors = widening(fit, fit, left)
    assert set(factors) == {parameter.name for parameter in fit.rig.free}
    assert all(1.0 <= factor < 2.0 for factor in factors.values())
