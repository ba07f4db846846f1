"""The posterior of an extended rig is widened by what remains unexplained, in memory and on disk."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from estimator.calibration.report import calibration_report
from estimator.calibration.result import Calibration
from estimator.calibration.sentences import warning_sentences
from estimator.diagnosis.corrections.result import Correction, Part
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.posterior import doubted, doubts, extended_posterior
from estimator.diagnosis.widening import Widening
from estimator.rig.rig import Cause, Rig
from estimator.store.session import Session
from tests.estimator.diagnosis.small_fits import fit_of

RADIUS, HEIGHT, COUNT = "coil1.radius_m", "coil1.world_from_coil0.z_m", "coil1.axial_loops"
POINTS_M = torch.tensor([[0.01, 0.01, 0.02], [0.02, -0.01, 0.03]], dtype=torch.float64)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("calibration")


@pytest.fixture(scope="module")
def widened(small_session: Session, small_rig: Rig, folder: Path) -> Calibration:
    """What remains unexplained widens intervals threefold."""
    fit = fit_of(small_rig, small_session.observations.calibration)
    wider = Widening(fit, 9.0 * fit.covariance)
    return extended_posterior(small_session, small_rig, wider, out=folder, seed=1)


def test_draws_are_wider_and_no_count_is_as_sure(small_calibration, widened):
    """Radius and height gain more than threefold, for they go along with a count that is no longer sure."""
    for name in (RADIUS, HEIGHT):
        assert widened.summary()["widening"][name] == pytest.approx(3.0)
        assert 3.0 < widened.draws[name].std() / small_calibration.draws[name].std() < 8.0
    surest = [
        calibration.summary()["loop_counts"][0]["probability"] for calibration in (small_calibration, widened)
    ]
    assert surest[0] > surest[1] + 0.1
    assert widened.summary()["has_integer_counts"]
    assert "widening" not in small_calibration.summary()


def test_draws_are_independent_and_nobody_is_told_that_sampling_did_not_converge(widened):
    """Also where the fit ended before its last digits, as a corrected one does."""
    fit = fit_of(widened.rig, widened.observations.calibration)
    early = Fit(fit.posterior, replace(fit.optimum, is_converged=torch.tensor([False])))
    session = Session(widened.rig, widened.observations, "by hand")
    wide = extended_posterior(session, widened.rig, Widening(early, 4.0 * fit.covariance))
    assert wide.summary()["is_converged"]
    assert not [warning for warning in warning_sentences(wide.summary()) if "converge" in warning]
    assert wide.summary()["parameters"][RADIUS]["ess_bulk"] > 0.8 * wide.summary()["sampling"]["smallest_ess"]


def test_best_values_are_those_of_the_most_probable_count(small_calibration, widened):
    """The same maximum that a calibration finds by Nelder-Mead."""
    assert widened.best[COUNT] == widened.summary()["loop_counts"][0]["axial"]
    if widened.best[COUNT] == small_calibration.best[COUNT]:
        for name, draws in small_calibration.draws.items():
            assert widened.best[name] == pytest.approx(small_calibration.best[name], abs=0.02 * draws.std())


def test_field_is_about_three_times_as_uncertain(small_calibration, widened):
    """Correlations that the readings impose are kept; widened one by one, the parameters would widen the field far more."""
    widths = [
        torch.diff(torch.stack(calibration.field_interval(POINTS_M, {"coil1": 3.0})), dim=0)
        for calibration in (small_calibration, widened)
    ]
    ratio = (widths[1] / widths[0]).numpy()
    assert (ratio > 2.8).all()
    assert (ratio < 4.2).all()


def test_summary_and_page_say_the_wider_intervals(widened):
    low, high = widened.summary()["parameters"][RADIUS]["ci90"]
    assert high - low == pytest.approx(2.0 * 1.645 * widened.draws[RADIUS].std(), rel=0.1)
    assert re.search(r"up to 3 times", calibration_report(widened, "coilcal diagnose session.zarr"))


def test_what_lies_on_disk_is_the_wide_posterior(widened, folder):
    stored = Calibration.load(folder)
    assert (stored.draws[RADIUS] == widened.draws[RADIUS]).all()
    assert stored.summary()["widening"] == widened.summary()["widening"]


def test_a_rig_with_a_doubtful_cause_gives_no_good_calibration(small_calibration):
    """A left-handed stage explains what swapped axes explain, with the coil on the other side."""
    good = small_calibration.summary()["quality"]
    words = "it holds only if axes_swapped is what is wrong (50 %)."
    told = doubted(small_calibration, [words]).summary()["quality"]
    assert good["verdict"] == "good"
    assert (told["verdict"], told["reasons"]) == ("suspect", [words])
    assert "Tell the causes apart first" in told["next"]
    twice = doubted(doubted(small_calibration, [words]), [words]).summary()["quality"]
    assert twice["reasons"] == [words, words[0].upper() + words[1:]]


def outcome(**parts: Any) -> Any:
    """As much of a diagnosis as doubts are read from; by default nothing is doubted."""
    usual: dict[str, Any] = {
        "sized_causes": (),
        "findings": SimpleNamespace(stand_ins=()),
        "fits": SimpleNamespace(correction=None),
        "verdict": SimpleNamespace(leaves_something=False),
        "label": lambda cause: cause.name,
    }
    return SimpleNamespace(**{**usual, **parts})


@pytest.mark.whole
@pytest.mark.parametrize("is_predicted", [False, True])
def test_a_calibration_that_follows_readings_as_no_prediction_does_is_not_good(is_predicted):
    curves = Part(Cause("axis_curves", "hall"), 8, 24, 50.0, 0.99, "to degree 8", is_predicted)
    correction = Correction(SimpleNamespace(), (curves,), {}, "", SimpleNamespace())
    told = (
        [] if is_predicted else ["it follows readings with axis_curves to degree 8, which no prediction has."]
    )
    assert doubts(outcome(fits=SimpleNamespace(correction=correction))) == told


@pytest.mark.whole
def test_a_calibration_of_what_is_not_sure_or_not_all_is_not_good():
    """Session 494063 of `make truthful`: gains stood for iron that nothing named, and the calibration beside `unexplained` was good."""
    gain = SimpleNamespace(stand_ins=(Cause("axis_gain", "hall"),))
    assert doubts(outcome()) == []
    assert doubts(outcome(findings=gain)) == ["it has axis_gain, not sure enough to be stated."]
    assert doubts(outcome(verdict=SimpleNamespace(leaves_something=True))) == [
        "the diagnosis found something wrong that this rig does not describe."
    ]
