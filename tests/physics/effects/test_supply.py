"""Effects of the supply against sums of magpylib's loops with the current that should flow, and heating against its differential equation."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from estimator.effects import EFFECTS
from estimator.effects.attach import with_effect
from estimator.effects.circumstances import Circumstances
from estimator.rig.rig import Cause
from estimator.rig_files.read import rig_from_text
from tests.physics.effects.laboratory import POINTS_M, RIG, assert_same_field, predicted_T, readings, winding

N = len(POINTS_M)


def coils_T(coil_A: object, other_A: object) -> np.ndarray:
    """Both coils by magpylib; the second stands across the first."""
    turn = Rotation.from_rotvec([0.0, -90.0, 0.0], degrees=True)
    in_other_m = turn.inv().apply(POINTS_M - np.array([0.12, 0.0, 0.0]))
    second = turn.apply(winding(0.03, 5, 3).field_T(in_other_m))
    first = winding().field_T(POINTS_M)
    return np.broadcast_to(coil_A, N)[:, None] * first + np.broadcast_to(other_A, N)[:, None] * second


def test_laboratory_without_effects_is_the_sum_of_magpylibs_loops():
    assert_same_field(predicted_T(readings(POINTS_M, (2.0, -3.0))), coils_T(2.0, -3.0))


def test_gain_and_offset_act_in_that_order():
    effects = {"current_offset[coil]": {"offset_A": 0.07}, "current_gain[coil]": {"excess": 0.03}}
    assert_same_field(predicted_T(readings(POINTS_M, (2.0, 0.0)), effects), coils_T(2.0 * 1.03 + 0.07, 0.0))


def test_current_step_takes_its_share_from_its_instant_on_and_of_its_coil_only():
    time_s = 1e9 + 600.0 * np.arange(N)
    observations = readings(POINTS_M, (2.0, -3.0), time_s=time_s)
    reading_T = predicted_T(observations, {"current_step[coil]": {"step": 0.02, "since_h": 0.6}})
    lost = 0.02 * np.array([0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0])  # from 36 minutes on
    assert_same_field(reading_T, coils_T(2.0 * (1.0 - lost), -3.0))
    later = observations.rows(observations.time_s >= time_s[3])
    part_T = predicted_T(later, {"current_step[coil]": {"step": 0.02, "since_h": 0.6}})
    assert_same_field(part_T, reading_T[3:])


TURNING = (  # each current, and the one from which it last turned back, read off by hand
    [2.0, 2.0, -1.0, -3.0, 0.0, 1.0, 0.5],
    [0.0, 0.0, 2.0, 2.0, -3.0, -3.0, 1.0],
)


def test_remanence_knows_the_currents_before_a_chosen_reading_and_not_what_read_back_currents_scatter():
    current_A, turned_A = np.array(TURNING)
    scattered_A = current_A + 1e-4 * np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0, -1.0])
    whole = readings(POINTS_M, np.stack((scattered_A, np.zeros(N)), axis=1))
    circumstances = Circumstances(rig_from_text(RIG), whole.rows(torch.tensor([6, 3])))
    np.testing.assert_allclose(circumstances.last_turn_A(0), turned_A[[6, 3]], atol=2e-4)


def test_remanence_needs_a_current_that_turns_back():
    effect, rig = EFFECTS["current_remanence"], rig_from_text(RIG)
    turning = readings(POINTS_M, np.stack((TURNING[0], np.linspace(0.5, 3.0, N)), axis=1))
    assert effect.concerns(Circumstances(rig, turning), "coil")
    assert not effect.concerns(Circumstances(rig, turning), "other")


def test_current_sign_exchanges_the_leads_of_one_coil():
    reading_T = predicted_T(readings(POINTS_M, (2.0, -3.0)), {"current_sign[other]": {"sign": -1.0}})
    assert_same_field(reading_T, coils_T(2.0, 3.0))


@pytest.mark.parametrize("tau_share", [0.1, 0.4, 2.0])
def test_coil_heating_follows_the_equation_of_one_thermal_mass(tau_share):
    """tau dw/dt = I(t)^2 - w from a cold start, the current held from one reading to the next; delivered is I (1 - loss w)."""
    n, duration_s, loss_per_A2 = 250, 5000.0, 2e-3
    time_s = np.linspace(0.0, duration_s, n)
    tau_s = tau_share * duration_s
    current_A = 3.0 * np.sign(np.sin(0.9 + 7.0 * time_s / duration_s)) * (time_s < 0.8 * duration_s)
    current_A += 1e-3  # so that a ratio can be taken everywhere

    def slope(t: float, w: np.ndarray) -> np.ndarray:
        held = min(int(t / duration_s * (n - 1)), n - 1)
        return (current_A[held] ** 2 - w) / tau_s

    heat = solve_ivp(slope, (0.0, duration_s), [0.0], t_eval=time_s, max_step=duration_s / n / 2).y[0]
    observations = readings(
        np.repeat(POINTS_M[:1], n, axis=0), np.stack((current_A, 0 * current_A), axis=1), time_s=time_s
    )
    given = {"loss_per_A2": loss_per_A2, "tau_h": tau_s / 3600.0}
    reading_T = predicted_T(observations, {"coil_heating[coil]": given})
    cold = predicted_T(observations)
    loss = 1.0 - reading_T[:, 2] / cold[:, 2]
    one_step = 9.0 / (
        tau_share * n
    )  # what a step warms the cold coil: the code takes its heat at the end of each
    assert np.abs(loss / loss_per_A2 - heat).max() < 1.5 * one_step < 0.1 * heat.max()


def test_heat_is_a_recursive_filter_of_the_squared_current_for_every_time_constant_of_a_batch():
    """By SciPy's filter: each step keeps exp(-step / tau) of what there was."""
    n = 77
    current_A = np.stack((np.random.default_rng(2).choice([0.0, 2.0, -3.0], n), np.zeros(n)), axis=1)
    observations = readings(np.repeat(POINTS_M[:1], n, axis=0), current_A, time_s=10.0 * np.arange(n))
    circumstances = Circumstances(rig_from_text(RIG), observations)
    step_h = circumstances.duration_h / n  # the session is cut into as many steps as there are readings
    held_A = current_A[[0, *range(n - 1)], 0]  # at the beginning of a step: a little before the next reading
    tau_h = torch.tensor([1e-4, 0.01, 0.2, 30.0], dtype=torch.float64)
    for tau, heat in zip(tau_h.tolist(), circumstances.heat_A2(0, tau_h), strict=True):
        kept = np.exp(-step_h / tau)
        filtered = lfilter([1.0 - kept], [1.0, -kept], held_A**2)
        assert heat.numpy() == pytest.approx(filtered, rel=1e-12, abs=1e-14)
    assert torch.autograd.gradcheck(lambda tau: circumstances.heat_A2(0, tau), tau_h[1:3].requires_grad_())


def test_coil_that_is_on_for_long_has_lost_its_share_per_square_ampere():
    n = 60
    observations = readings(np.repeat(POINTS_M[:1], n, axis=0), (2.0, 0.0), time_s=100.0 * np.arange(n))
    effect = {"coil_heating[coil]": {"loss_per_A2": 0.01, "tau_h": 200.0 / 3600.0}}
    assert predicted_T(observations, effect)[-1, 2] / predicted_T(observations)[-1, 2] == pytest.approx(
        1.0 - 0.01 * 2.0**2, abs=1e-6
    )


def test_heat_is_the_same_for_a_part_of_the_session_and_for_readings_out_of_order():
    n = 80
    random = np.random.default_rng(1)
    current_A = np.stack((random.choice([0.0, 2.0, -3.0], n), np.zeros(n)), axis=1)
    observations = readings(random.uniform(0.03, 0.05, (n, 3)), current_A, time_s=10.0 * np.arange(n))
    tau_h = torch.tensor(0.05, dtype=torch.float64)
    rig = rig_from_text(RIG)
    whole = Circumstances(rig, observations).heat_A2(0, tau_h)
    rows = torch.from_numpy(random.permutation(n)[:30])
    torch.testing.assert_close(Circumstances(rig, observations.rows(rows)).heat_A2(0, tau_h), whole[rows])


def test_heating_by_a_thermometer_is_the_loss_per_kelvin_above_the_coolest():
    celsius = np.array([20.0, 21.0, 24.0, np.nan, 23.0, 20.0, 24.0])
    observations = readings(POINTS_M, (2.0, -3.0), temperature_C={"coil": celsius})
    reading_T = predicted_T(observations, {"coil_heating[coil]": {"loss_per_K": 0.004, "tau_h": 1.0}})
    kelvin = np.nan_to_num(celsius, nan=np.nanmean(celsius)) - 20.0
    assert_same_field(reading_T, coils_T(2.0 * (1.0 - 0.004 * kelvin), -3.0))


@pytest.mark.parametrize(
    ("celsius", "free"),
    [
        (None, {"loss_per_A2", "tau_h"}),
        (np.full(N, 20.0), {"loss_per_A2", "tau_h"}),
        (np.linspace(20.0, 26.0, N), {"loss_per_K"}),
    ],
    ids=["no thermometer", "one that did not move", "one that did"],
)
def test_heating_is_fitted_by_the_thermometer_that_moved_or_else_by_the_losses(celsius, free):
    """Both at once say the same thing, and a fit of both finds no end."""
    observations = readings(POINTS_M, (2.0, -3.0), temperature_C={} if celsius is None else {"coil": celsius})
    rig = rig_from_text(RIG)
    heating = Cause("coil_heating", "coil")
    hypothesis = with_effect(rig, heating, observations, {})
    assert {p.name.rpartition(".")[2] for p in hypothesis.free if p.name.startswith(heating.label)} == free


COMMANDED_A = np.array([2.0, -2.0, 0.0, 1.0, 0.05, -0.5, 3.0])


@pytest.mark.parametrize(
    ("cause", "given", "expected_A"),
    [
        ("current_dead_band", {"band_A": 0.1}, np.array([1.9, -1.9, 0.0, 0.9, 0.0, -0.4, 2.9])),
        ("current_dead_band", {"band_A": -0.1}, np.array([2.1, -2.1, 0.0, 1.1, 0.15, -0.6, 3.1])),
        ("current_asymmetry", {"excess": 0.02}, np.where(COMMANDED_A > 0, 1.02, 0.98) * COMMANDED_A),
        ("current_compression", {"loss_per_A2": 0.01}, COMMANDED_A - 0.01 * COMMANDED_A**3),
        ("current_limit", {"limit_A": 1.8}, np.clip(COMMANDED_A, -1.8, 1.8)),
        (
            "current_range",
            {"excess": 0.03, "below_A": 1.7},
            [1.03 * one_A if -1.7 < one_A < 1.7 else one_A for one_A in COMMANDED_A],
        ),
    ],
)
def test_supply_that_is_not_linear_delivers_by_its_own_curve(cause, given, expected_A):
    current_A = np.stack((COMMANDED_A, np.full(N, 0.5)), axis=1)
    reading_T = predicted_T(readings(POINTS_M, current_A), {f"{cause}[coil]": given})
    assert_same_field(reading_T, coils_T(expected_A, 0.5))


@pytest.mark.parametrize(
    ("current_A", "asked"),
    [
        ([2.0, 2.0], set()),
        ([2.0, -2.0, 0.0], {"current_asymmetry"}),
        ([2.0, 1.0], {"current_dead_band", "current_compression", "current_limit", "current_range"}),
        (
            [2.0, -1.0],
            {
                "current_asymmetry",
                "current_dead_band",
                "current_compression",
                "current_limit",
                "current_range",
            },
        ),
    ],
)
def test_curves_of_a_supply_are_asked_where_currents_could_show_them(current_A, asked):
    columns = np.stack((np.resize(current_A, N), np.zeros(N)), axis=1)
    circumstances = Circumstances(rig_from_text(RIG), readings(POINTS_M, columns))
    names = (
        "current_asymmetry",
        "current_dead_band",
        "current_compression",
        "current_limit",
        "current_range",
    )
    assert {name for name in names if EFFECTS[name].concerns(circumstances, "coil")} == asked


def test_ranges_end_between_currents_that_flowed_and_each_parts_them_otherwise():
    columns = np.stack((np.resize([2.0, -2.0, 0.0, 1.0, -0.3], N), np.zeros(N)), axis=1)
    circumstances = Circumstances(rig_from_text(RIG), readings(POINTS_M, columns))
    starts = EFFECTS["current_range"].starts(circumstances, "coil")
    assert [start["below_A"] for start in starts] == pytest.approx([0.65, 1.5])
