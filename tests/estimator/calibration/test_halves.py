"""Halves of a session disagree where the model is wrong, as often as stated where it is right, and in the half that is wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy import stats

from estimator.calibration.halves import disagreements, unseen
from estimator.calibration.linear_fit import LinearFit
from estimator.effects.circumstances import Circumstances
from estimator.model.simulate import simulate
from estimator.readings.observations import Observations
from estimator.readings.plan import plan_from_text
from estimator.rig_files.read import rig_from_text
from estimator.rig_files.starter import Starter, starter_plan_text, starter_rig_text

pytestmark = pytest.mark.whole

RIG = rig_from_text(starter_rig_text(Starter()))
PLAN = plan_from_text(starter_plan_text(Starter()), RIG)
TRUTH = {
    "coil1.radius_m": 0.049,
    "coil1.world_from_coil0.tilt_x_rad": 0.02,
    "background_field[room].z_T": -43e-6,
}


def readings(seed: int) -> Observations:
    return simulate(RIG, PLAN, TRUTH, seed=seed).calibration


def found(observations: Observations) -> list[tuple[str, float]]:
    told = disagreements(LinearFit.of(RIG, observations, {**RIG.nominal_values(), **TRUTH}))
    return [(each.words, each.p_value) for each in told]


def changed(observations: Observations, rows: torch.Tensor, added_T: torch.Tensor) -> Observations:
    field_T = observations.field_sensor_T.clone()
    field_T[rows] += added_T
    return observations.with_field(field_T)


@pytest.fixture(scope="module")
def right() -> list[list[tuple[str, float]]]:
    """What is found in sessions of the model itself."""
    return [found(readings(seed)) for seed in range(60)]


def test_the_smallest_of_all_probabilities_is_as_rare_as_it_says(right):
    smallest = np.array([told[0][1] for told in right])
    n_small = int((smallest < 0.2).sum())
    assert stats.binomtest(n_small, len(smallest), 0.2, "greater").pvalue > 1e-3
    assert n_small, "a test that never speaks says nothing"


def test_each_probability_is_uniform_where_the_model_is_right(right):
    below = []
    for told in right:
        (p_value,) = [p_value for words, p_value in told if words.startswith("the first half")]
        below.append(p_value < 1.0)  # adjusted values end at 1: of n tests, one in n is below
    assert stats.binomtest(sum(below), len(below), 1.0 / len(right[0])).pvalue > 1e-3


@pytest.mark.parametrize("size_T", [30e-6])
def test_a_half_that_is_shifted_is_told_by_its_name(size_T):
    made = readings(1)
    shift_T = torch.tensor([size_T, -size_T, size_T], dtype=torch.float64)
    off = (made.current_A == 0.0).all(dim=1)
    assert "without current" in found(changed(made, off, shift_T))[0][0]
    late = made.time_s > made.time_s.median()
    assert (
        found(changed(made, late, shift_T))[0][0] == "the first half of the session disagrees with the second"
    )


def test_a_mover_that_leans_to_the_side_of_its_last_move_is_told_with_the_axis():
    made = readings(5)
    side = Circumstances(RIG, made).approach(RIG.movers[0].name)[:, 2]
    shift_T = 20e-6 * side[:, None] * torch.tensor([[1.0, -1.0, 1.0]], dtype=torch.float64)
    told = found(made.with_field(made.field_sensor_T + shift_T))
    assert "reached upwards along its z axis" in told[0][0]
    assert told[0][1] < 1e-3


def test_an_axis_with_a_wrong_gain_and_a_turned_sensor_are_seen():
    made = readings(2)
    field_T = made.field_sensor_T.clone()
    field_T[:, 0] *= 1.01
    assert found(made.with_field(field_T))[0][1] < 1e-3
    turn_rad = torch.tensor([[0.0, -0.01, 0.0], [0.01, 0.0, 0.0], [0.0, 0.0, 0.0]], dtype=torch.float64)
    turned = made.with_field(made.field_sensor_T + made.field_sensor_T @ turn_rad.T)
    assert found(turned)[0][1] < 1e-6


def test_a_share_of_the_field_before_is_told_by_its_name():
    made = readings(4)
    before_T = torch.roll(made.field_sensor_T, 1, dims=0)
    before_T[0] = 0.0
    told = found(made.with_field(made.field_sensor_T + 0.01 * before_T))
    assert "the same sensor read before" in told[0][0]
    assert told[0][1] < 1e-3


def unseen_p_value(seed: int, shift_T: float = 0.0) -> float:
    """Half of the readings fitted, the other half shifted."""
    made = readings(seed)
    is_seen = torch.arange(len(made)) % 2 == 0
    moved = made.with_field(made.field_sensor_T + shift_T).rows(~is_seen)
    values = {**RIG.nominal_values(), **TRUTH}
    return unseen(LinearFit.of(RIG, made.rows(is_seen), values), LinearFit.of(RIG, moved, values)).p_value


def test_unseen_readings_agree_as_often_as_stated_and_not_where_they_are_shifted():
    p_values = [unseen_p_value(100 + seed) for seed in range(60)]
    assert stats.kstest(p_values, "uniform").pvalue > 1e-3
    assert unseen_p_value(1, shift_T=20e-6) < 1e-3


def test_missing_components_and_few_readings_are_no_obstacle():
    made = readings(3)
    field_T = made.field_sensor_T.clone()
    field_T[::2, 1] = float("nan")
    assert 0.0 < found(made.with_field(field_T))[0][1] <= 1.0
    few = made.rows(torch.arange(8))
    assert all(0.0 <= p <= 1.0 for _, p in found(replace(few)))
