"""What makes a successor of a fit: it must predict better, be sampled to its targets, and be younger than what it replaces."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from estimator.calibration.calibrate import calibrate
from estimator.calibration.result import Calibration
from estimator.diagnosis.validation import Improvement
from estimator.errors import InvalidInput
from estimator.inference.ensemble import SamplerSettings
from estimator.model.simulate import simulate
from estimator.readings.plan import Plan
from estimator.recalibration import comparison, judgement, successor
from estimator.recalibration.conclusion import Conclusion, Judgement
from estimator.recalibration.judgement import judge
from estimator.recalibration.successor import stored_log_density
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text
from estimator.store.session import Session

TOO_FEW_STEPS = SamplerSettings(n_walkers=16, target_ess=1e6, max_steps=100)


@pytest.fixture(scope="module")
def mounted_anew(small_rig: Rig, small_plan: Plan, small_truth: dict[str, float]) -> Session:
    truth = {**small_truth, "coil1.world_from_coil0.z_m": -0.0405}
    return Session(small_rig, simulate(small_rig, small_plan, truth, seed=7), "simulated")


@pytest.fixture
def is_sampled(monkeypatch: pytest.MonkeyPatch) -> list[bool]:
    """One entry for each time that a successor was sampled; none is."""
    asked: list[bool] = []

    def sampled(*_: object) -> Calibration:
        asked.append(True)
        raise AssertionError("must not be sampled")

    monkeypatch.setattr(comparison, "sampled_successor", sampled)
    return asked


def test_no_successor_is_made_of_a_fit_that_predicts_unseen_readings_no_better(
    mounted_anew, small_rig, small_calibration, monkeypatch, is_sampled
):
    real = comparison.improvement_of

    def small_improvement(*arguments: object) -> Improvement:
        return replace(real(*arguments), elpd_difference=1.9, elpd_se=1.0)  # type: ignore[arg-type]

    monkeypatch.setattr(comparison, "improvement_of", small_improvement)
    judged = judge(mounted_anew, small_rig, small_calibration, seed=1)
    assert (judged.conclusion, judged.calibration, judged.agrees) == ("unchanged", None, False)
    assert judged.reason.startswith(
        "disagrees with the current version (p < 0.0001); the new fit does not predict"
    )
    assert not is_sampled


def test_a_successor_that_did_not_converge_does_not_replace_and_it_is_said(
    mounted_anew, small_rig, small_calibration
):
    judged = judge(mounted_anew, small_rig, small_calibration, seed=1, settings=TOO_FEW_STEPS)
    assert (judged.conclusion, judged.calibration) == ("unchanged", None)
    assert judged.checks["is_successor_converged"] is False
    assert "but its posterior did not converge (" in judged.reason
    assert judged.reason.endswith(": the current version stays")


def test_a_first_calibration_that_did_not_converge_is_kept_for_there_is_no_other_and_it_is_said(
    small_session, small_rig
):
    judged = judge(small_session, small_rig, None, seed=1, settings=TOO_FEW_STEPS)
    assert judged.calibration is not None
    assert judged.checks["is_successor_converged"] is False
    assert judged.reason.startswith("first calibration; its posterior did not converge (")
    assert judged.reason.endswith("intervals are provisional")


def test_a_successor_whose_stored_draws_predict_worse_does_not_replace(
    mounted_anew, small_rig, small_calibration, small_settings, monkeypatch
):
    def gone_astray(*arguments: object) -> Calibration:
        del arguments
        draws = dict(small_calibration.draws)
        draws["coil1.world_from_coil0.z_m"] = draws["coil1.world_from_coil0.z_m"] - 5e-3
        return replace(small_calibration, draws=draws)

    monkeypatch.setattr(comparison, "sampled_successor", gone_astray)
    judged: Judgement = judge(mounted_anew, small_rig, small_calibration, seed=1, settings=small_settings)
    assert (judged.conclusion, judged.calibration) == ("unchanged", None)
    assert "its sampled posterior predicts them worse (log density -" in judged.reason


def test_log_density_of_draws_is_that_of_the_readings_under_a_sharp_posterior(
    small_calibration, small_session
):
    unseen = small_session.observations.validation
    best = small_calibration.best_values()
    draws = {name: torch.full((4, 5), float(best[name])).numpy() for name in small_calibration.draws}
    sharp = replace(small_calibration, draws=draws, log_prob=torch.zeros(4, 5).numpy())
    field_T = sharp.room(torch.zeros(len(unseen), 3, dtype=torch.float64), {"arm1": unseen.motion["arm1"]})
    predicted_T = field_T.field_T(best, unseen.current_A[0])
    noise = torch.distributions.Normal(predicted_T, 5e-6)
    wanted = noise.log_prob(unseen.field_sensor_T).sum(1)
    assert torch.allclose(stored_log_density(sharp, unseen), wanted, rtol=1e-6)


def test_a_fault_of_the_registry_is_no_verdict_on_the_session(
    mounted_anew, small_rig, small_calibration, monkeypatch
):
    def refuse(*_: object) -> Rig:
        raise InvalidInput("the rig of version 1 cannot be widened")

    monkeypatch.setattr(judgement, "widened_rig", refuse)
    with pytest.raises(InvalidInput, match="cannot be widened"):
        judge(mounted_anew, small_rig, small_calibration, seed=1)


@pytest.mark.slow  # a season with a drift is in test_recalibrate
def test_walkers_that_are_too_few_for_a_rig_with_a_cause_are_made_enough(
    small_session, small_rig, small_plan, small_truth, small_calibration, monkeypatch
):
    asked: list[SamplerSettings] = []

    def calibrated(_: Session, rig: Rig, *, settings: SamplerSettings, **__: object) -> Calibration:
        asked.append(settings.for_rig(len(rig.free)))
        return small_calibration

    assert calibrate is successor.calibrate
    monkeypatch.setattr(successor, "calibrate", calibrated)
    readings = simulate(small_rig, small_plan, small_truth, 4, {"background_field.x_T": 20e-6})
    drifted = replace(small_session, observations=readings)
    judged = judge(drifted, small_rig, small_calibration, seed=1, settings=SamplerSettings(n_walkers=6))
    assert judged.conclusion == "drifted"
    assert asked[0].n_walkers >= 12


@pytest.mark.whole
@pytest.mark.slow  # a season with a drift is in test_recalibrate
def test_more_current_since_the_last_version_is_no_change_of_the_winding(
    rig_text, small_plan, small_truth, small_settings
):
    rig = rig_from_text(rig_text.replace("noise_uT: 5", "noise_uT: 1"))
    first, later = (
        Session(rig, simulate(rig, small_plan, small_truth, seed, hidden), "simulated")
        for seed, hidden in ((1, None), (9, {"current_gain.excess": 0.04}))
    )
    current = calibrate(first, settings=small_settings, seed=1)
    judged = judge(later, rig, current, may_replace=False, seed=1)
    assert judged.conclusion == "drifted"
    (cause,) = judged.causes
    names = {cause["name"], *(other["name"] for other in cause["alternatives"])}
    assert names == {"current_gain", "current_offset"}  # with one current, they are the same
    asked = {label.partition("[")[0] for label in judged.checks["log_bayes_factors"]}
    assert not {"hidden_winding", "short_layer", "reversed_layer", "winding_misstated"} & asked


def test_a_session_with_rows_that_were_not_measured_is_rejected(small_rig, small_session):
    """A block of rows holds the fields of earlier ones: no first calibration is made of it."""
    readings = small_session.observations
    field_T = readings.field_sensor_T.clone()
    field_T[18:24] = field_T[7:13]
    judged = judge(replace(small_session, observations=readings.with_field(field_T)), small_rig, None, seed=1)
    assert judged.conclusion is Conclusion.REJECTED
    assert "hall holds the fields of earlier readings, in readings 19 to 24" in judged.reason
    assert judged.calibration is None
