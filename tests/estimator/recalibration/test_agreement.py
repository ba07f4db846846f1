"""The test of agreement: its false-alarm rate is the one it states, and it sees what it should see."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy import stats

from estimator.calibration.result import Calibration
from estimator.diagnosis.fitting import fit_rig
from estimator.model.measurement_model import MeasurementModel
from estimator.model.simulate import simulate
from estimator.readings.observations import Observations
from estimator.readings.plan import Plan
from estimator.recalibration import agreement, policy
from estimator.recalibration.agreement import Agreement
from estimator.recalibration.widening import widened_rig
from estimator.rig.rig import Rig

N_SESSIONS = 40


def asked(calibration: Calibration, rig: Rig, observations: Observations) -> Agreement:
    widened = widened_rig(calibration, rig)
    rules = MeasurementModel.build(widened, observations).rules
    refit = fit_rig(widened, observations, widened.nominal_values(), rules)
    return agreement.agreement(calibration, observations, refit, seed=1)


@pytest.fixture(scope="module")
def clean(small_calibration: Calibration, small_rig: Rig, small_plan: Plan) -> list[Observations]:
    """Sessions whose truth is drawn from the posterior: what the calibration says is exactly right about them."""
    truths = small_calibration.draw_values(N_SESSIONS)
    return [
        simulate(
            small_rig, small_plan, {n: float(truths[n][k]) for n in small_calibration.draws}, seed=100 + k
        )
        for k in range(N_SESSIONS)
    ]


@pytest.fixture
def quickly(
    monkeypatch: pytest.MonkeyPatch, small_calibration: Calibration, small_rig: Rig, clean: list[Observations]
) -> Callable[[Calibration], list[Agreement]]:
    """All clean sessions, with one refit and its columns of causes for all of them, and fewer simulated sessions."""
    widened = widened_rig(small_calibration, small_rig)
    refit = fit_rig(
        widened, clean[0], widened.nominal_values(), MeasurementModel.build(widened, clean[0]).rules
    )
    columns = agreement._cause_columns(refit, torch.full((3 * len(clean[0]),), 5e-6, dtype=torch.float64))
    monkeypatch.setattr(agreement, "_cause_columns", lambda *_: columns)
    monkeypatch.setattr(policy, "N_SIMULATED", 2000)
    return lambda calibration: [
        agreement.agreement(calibration, readings, refit, seed=k) for k, readings in enumerate(clean)
    ]


@pytest.mark.slow
def test_p_values_of_clean_sessions_are_uniform(quickly, small_calibration):
    agreements = quickly(small_calibration)
    joint = np.array([test.p_value for test in agreements])
    assert stats.kstest(joint, "uniform").pvalue > 0.01
    for name in agreements[0].by_test:
        assert stats.kstest([test.by_test[name] for test in agreements], "uniform").pvalue > 0.01
    assert (joint < 0.05).sum() <= 7  # of 40; more have a probability of 0.2 %


@pytest.mark.slow
def test_a_posterior_that_is_too_narrow_gives_false_alarms(quickly, small_calibration):
    narrow = {n: draws.mean() + 0.1 * (draws - draws.mean()) for n, draws in small_calibration.draws.items()}
    right, wrong = (
        [test.by_test["parameters"] for test in quickly(calibration)]
        for calibration in (small_calibration, replace(small_calibration, draws=narrow))
    )
    assert stats.wilcoxon(wrong, right, alternative="less").pvalue < 1e-3
    assert sum(p < 0.05 for p in wrong) > sum(p < 0.05 for p in right)


def test_a_cause_that_parameters_cannot_follow_is_seen_by_its_column(
    small_calibration, small_rig, small_plan, small_truth
):
    hidden = {"background_field.x_T": 15e-6}
    readings = simulate(small_rig, small_plan, small_truth, seed=8, hidden=hidden)
    outcome = asked(small_calibration, small_rig, readings)
    assert not outcome.holds
    assert not outcome.is_refit_enough
    # What changed at the very beginning, room, zero or sensor, has the same column but for a few readings.
    since_the_beginning = {"background_step[room]", "offset_step[hall]", "sensor_exchanged[hall]"}
    assert outcome.striking_cause in {"background_field[room]", "sensor_offset[hall]", *since_the_beginning}


@pytest.mark.parametrize(
    ("p_value", "agrees"), [(0.5, True), (0.05, True), (0.002, True), (0.0009, False), (5e-5, False)]
)
def test_one_session_in_a_thousand_disagrees_by_chance(p_value, agrees):
    """One false alarm in twenty years of weekly sessions, as README and decision 14 promise."""
    assert Agreement(p_value, {}, 0.5, 1.0, None).holds is agrees
    assert Agreement(0.5, {}, p_value, 1.0, None).is_refit_enough is agrees
