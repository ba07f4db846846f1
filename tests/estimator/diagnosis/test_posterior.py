"""The posterior of an extended rig is widened by what remains unexplained, in memory and on disk."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import torch

from estimator.calibration.report import calibration_report
from estimator.calibration.result import Calibration
from estimator.diagnosis.posterior import extended_posterior
from estimator.diagnosis.widening import Widening
from estimator.inference.ensemble import SamplerSettings
from estimator.rig.rig import Rig
from estimator.store.session import Session
from tests.estimator.diagnosis.small_fits import fit_of

RADIUS, HEIGHT, COUNT = "coil1.radius_m", "coil1.world_from_coil0.z_m", "coil1.axial_loops"
POINTS_M = torch.tensor([[0.01, 0.01, 0.02], [0.02, -0.01, 0.03]], dtype=torch.float64)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("calibration")


@pytest.fixture(scope="module")
def widened(
    small_session: Session, small_rig: Rig, folder: Path, small_settings: SamplerSettings
) -> Calibration:
    """What remains unexplained widens intervals threefold."""
    fit = fit_of(small_rig, small_session.observations.calibration)
    wider = Widening(fit, 9.0 * fit.covariance)
    return extended_posterior(small_session, small_rig, wider, out=folder, seed=1, settings=small_settings)


def test_draws_are_wider_and_no_count_is_as_sure(small_calibration: Calibration, widened: Calibration):
    """Radius and height gain more than threefold, for they go along with a count that is no longer sure."""
    factors = widened.summary()["widening"]
    for name in (RADIUS, HEIGHT):
        assert widened.draws[name].std() == pytest.approx(factors[name] * small_calibration.draws[name].std())
        assert 3.0 < factors[name] < 8.0
    surest = [
        calibration.summary()["loop_counts"][0]["probability"] for calibration in (small_calibration, widened)
    ]
    assert surest[0] > surest[1] + 0.1
    assert widened.summary()["has_integer_counts"]
    assert "widening" not in small_calibration.summary()


def test_field_is_about_three_times_as_uncertain(small_calibration: Calibration, widened: Calibration):
    """Correlations that the readings impose are kept; widened one by one, the parameters would widen the field far more."""
    widths = [
        torch.diff(torch.stack(calibration.field_interval(POINTS_M, {"coil1": 3.0})), dim=0)
        for calibration in (small_calibration, widened)
    ]
    ratio = (widths[1] / widths[0]).numpy()
    assert (ratio > 2.8).all()
    assert (ratio < 4.2).all()


def test_summary_and_page_say_the_wider_intervals(widened: Calibration):
    low, high = widened.summary()["parameters"][RADIUS]["ci90"]
    assert high - low == pytest.approx(2.0 * 1.645 * widened.draws[RADIUS].std(), rel=0.1)
    assert re.search(
        r"up to [3-7](\.\d+)? times", calibration_report(widened, "coilcal diagnose session.zarr")
    )


def test_what_lies_on_disk_is_the_wide_posterior(widened: Calibration, folder: Path):
    stored = Calibration.load(folder)
    assert (stored.draws[RADIUS] == widened.draws[RADIUS]).all()
    assert stored.summary()["widening"] == widened.summary()["widening"]
