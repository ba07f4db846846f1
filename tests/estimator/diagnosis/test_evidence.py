"""Laplace's log evidence against importance sampling, which needs no normal shape of the posterior."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from estimator.diagnosis.fitting import Fit
from estimator.rig.rig import Cause
from estimator.rig_files.read import load_rig
from estimator.store.importers.readings_csv import read_readings_csv
from tests.estimator.diagnosis.small_fits import fit_of
from tests.hidden.session import draw_session

CAUSES = (Cause("axis_gain", "hall"), Cause("cross_axis", "hall"), Cause("background_field", "room"))
DRAWS, FREEDOM = 4000, 8.0


def missed_by_laplace(fit: Fit) -> tuple[float, float]:
    """Log of the integral of the density over Laplace's estimate of it, with the standard error of the integral.

    Draws of Student's t about the maximum with Laplace's covariance, weighed by the density (MacKay 2003, section 29.2).
    """
    generator = torch.Generator().manual_seed(1)
    n = len(fit.vector)
    root = torch.linalg.cholesky(fit.covariance)
    normal = torch.randn(DRAWS, n, generator=generator, dtype=torch.float64)
    squares = torch.randn(DRAWS, int(FREEDOM), generator=generator, dtype=torch.float64).square().mean(1)
    step = normal / squares.sqrt()[:, None]
    log_proposal = -0.5 * (FREEDOM + n) * torch.log1p(step.square().sum(1) / FREEDOM)
    log_peak = (
        math.lgamma(0.5 * (FREEDOM + n)) - math.lgamma(0.5 * FREEDOM) - 0.5 * n * math.log(0.5 * FREEDOM)
    )
    with torch.no_grad():
        vectors = fit.vector + step @ root.T
        log_density = torch.cat([fit.posterior(part) for part in vectors.split(500)])
    weight = torch.exp(log_density - fit.optimum.log_posterior[0] - log_proposal)
    return float(weight.mean().log()) - log_peak, float(weight.std() / weight.mean()) / math.sqrt(DRAWS)


@pytest.fixture(scope="module")
def fits(tmp_path_factory: pytest.TempPathFactory) -> list[Fit]:
    """A session with a hidden gain error, from independent code, fitted with the plain rig, the true cause, and two other causes."""
    folder = tmp_path_factory.mktemp("evidence")
    draw_session(1, "axis_gain", 8.0).write(Path(folder))
    rig = load_rig(folder / "rig.yaml")
    readings = read_readings_csv(folder / "readings.csv", rig).observations.calibration
    return [fit_of(rig, readings), *(fit_of(rig, readings, cause) for cause in CAUSES)]


def test_evidence_of_laplace_is_that_of_importance_sampling(fits):
    """All agree within a third; decisions need log 20 = 3.0."""
    for fit in fits:
        missed, error = missed_by_laplace(fit)
        assert error < 0.15
        assert missed == pytest.approx(0.0, abs=0.33)


def test_differences_between_hypotheses_are_closer_still(fits):
    plain, *others = (missed_by_laplace(fit)[0] for fit in fits)
    assert [missed - plain for missed in others] == pytest.approx([0.0] * len(others), abs=0.3)


def test_a_wrong_width_shows(fits):
    """Were every standard deviation twice as large, the estimate would be 2^n too large."""
    fit = fits[1]
    wide = Fit(fit.posterior, replace(fit.optimum, precision=fit.optimum.precision / 4.0))
    missed, _ = missed_by_laplace(wide)
    assert missed == pytest.approx(-len(fit.vector) * math.log(2.0), abs=0.6)
