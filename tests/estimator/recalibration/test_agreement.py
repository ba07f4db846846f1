"""The test of agreement: its false-alarm rate is the one it states, and it sees what it should see."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
import torch
from scipy import stats

from estimator.calibration import Calibration
from estimator.chain import Chain
from estimator.diagnosis.fitting import fit_rig
from estimator.plan import Plan
from estimator.recalibration.agreement import Agreement, agreement
from estimator.recalibration.widening import widened_rig
from estimator.records import Observations
from estimator.rig import Rig
from estimator.simulate import simulate

N_SESSIONS = 40


def asked(calibration: Calibration, rig: Rig, observations: Observations) -> Agreement:
    widened = widened_rig(calibration, rig)
    rules = Chain.build(widened, observations).rules
    refit = fit_rig(widened, observations, widened.nominal_values(), rules)
    return agreement(calibration, observations, refit, seed=1)


@pytest.fixture(scope="module")
def of_clean_sessions(small_calibration: Calibration, small_rig: Rig, small_plan: Plan) -> list[Agreement]:
    """Sessions whose truth is drawn from the posterior: what the calibration says is exactly right about them."""
    truths: Mapping[str, torch.Tensor] = small_calibration.draw_values(N_SESSIONS)
    return [
        asked(
            small_calibration,
            small_rig,
            simulate(
                small_rig, small_plan, {n: float(truths[n][k]) for n in small_calibration.draws}, seed=100 + k
            ),
        )
        for k in range(N_SESSIONS)
    ]


def test_p_values_of_clean_sessions_are_uniform(of_clean_sessions: list[Agreement]) -> None:
    joint = np.array([one.p_value for one in of_clean_sessions])
    assert stats.kstest(joint, "uniform").pvalue > 0.01
    for name in of_clean_sessions[0].by_test:
        assert stats.kstest([one.by_test[name] for one in of_clean_sessions], "uniform").pvalue > 0.01
    assert (joint < 0.05).sum() <= 7  # of 40; more have a probability of 0.2 %


def test_a_posterior_that_is_too_narrow_gives_false_alarms(
    small_calibration: Calibration, small_rig: Rig, small_plan: Plan
) -> None:
    truths = small_calibration.draw_values(N_SESSIONS)
    centre = {name: np.full_like(draws, draws.mean()) for name, draws in small_calibration.draws.items()}
    centre["coil1.axial_loops"] = np.round(centre["coil1.axial_loops"])
    narrow = Calibration(
        small_rig,
        small_calibration.observations,
        small_calibration.best,
        centre,
        small_calibration.log_prob,
        small_calibration.record,
    )
    p_values = []
    for k in range(0, N_SESSIONS, 2):
        truth = {n: float(truths[n][k]) for n in small_calibration.draws}
        readings = simulate(small_rig, small_plan, truth, seed=100 + k)
        p_values.append(asked(narrow, small_rig, readings).by_test["parameters"])
    assert stats.kstest(p_values, "uniform").pvalue < 0.01


def test_a_coil_mounted_anew_disagrees_but_a_refit_is_enough(
    small_calibration: Calibration, small_rig: Rig, small_plan: Plan, small_truth: dict[str, float]
) -> None:
    truth = {**small_truth, "coil1.world_from_coil0.z_m": -0.0405}
    found = asked(small_calibration, small_rig, simulate(small_rig, small_plan, truth, seed=7))
    assert not found.holds
    assert found.is_refit_enough


def test_a_cause_that_parameters_cannot_follow_is_seen_by_its_column(
    small_calibration: Calibration, small_rig: Rig, small_plan: Plan, small_truth: dict[str, float]
) -> None:
    hidden = {"background_field.x_T": 15e-6}
    readings = simulate(small_rig, small_plan, small_truth, seed=8, hidden=hidden)
    found = asked(small_calibration, small_rig, readings)
    assert not found.holds
    assert not found.is_refit_enough
    assert found.striking_cause in ("background_field[room]", "sensor_offset[hall]")
