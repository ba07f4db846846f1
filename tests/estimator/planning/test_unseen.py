"""What causes may do unseen: by brute force in a linear model, and goals that stay kept beside a hidden one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
import torch
from torch import Tensor

from estimator.effects import EFFECTS
from estimator.model.measurement_model import MeasurementModel
from estimator.planning.candidates import clear_candidates
from estimator.planning.causes import with_ordinary
from estimator.planning.unseen import ODDS, SURE, Unseen

N_OWN, N_CAUSES, N_NUMBERS = 3, 4, 5
N_SESSIONS = 80
TARGET = 0.05  # variance of the numbers that are wanted
OWN = torch.tensor([True] * N_OWN + [False] * N_CAUSES)


@dataclass
class Linear:
    """Readings that are linear in three parameters and four quantities of causes, with unit noise."""

    columns: Tensor
    prior: Tensor
    wanted: Tensor
    rng: np.random.Generator

    @classmethod
    def drawn(cls, seed: int, n_readings: int) -> Linear:
        rng = np.random.default_rng(seed)
        columns = torch.from_numpy(rng.normal(size=(n_readings, N_OWN + N_CAUSES)))
        columns[:, 3] = columns[:, 0] + 0.5 * columns[:, 3]  # nearly followed by a parameter
        prior = torch.diag(torch.tensor([1e-4] * N_OWN + [1.0] * N_CAUSES, dtype=torch.float64))
        wanted = torch.from_numpy(rng.normal(size=(N_NUMBERS, N_OWN + N_CAUSES)))
        wanted[:, N_OWN:] = 0.0  # causes of the sensor, which the field does not have
        return cls(columns, prior, wanted, rng)

    def judged(self, truth: Tensor, is_usual: Tensor | None = None) -> tuple[Unseen, Tensor, Tensor]:
        """What is unseen, the error of the fit's numbers, and their mean variance by the fit alone."""
        measured = self.columns @ truth + torch.from_numpy(self.rng.normal(size=len(self.columns)))
        own = self.columns[:, OWN]
        precision = own.T @ own + self.prior[OWN][:, OWN]
        estimate = torch.linalg.solve(precision, own.T @ measured)
        score = self.columns.T @ (measured - own @ estimate)
        score[OWN] -= self.prior[OWN][:, OWN] @ estimate
        unseen = Unseen.of(self.columns.T @ self.columns, score, self.prior, [self.wanted], OWN, is_usual)
        rows = self.wanted[:, OWN]
        variance = ((rows @ torch.linalg.inv(precision)) * rows).sum(-1).mean()
        return unseen, rows @ (estimate - truth[OWN]) - self.wanted[:, ~OWN] @ truth[~OWN], variance


def test_each_quantity_is_that_of_a_fit_with_it():
    linear = Linear.drawn(1, 20)
    truth = torch.tensor([1.0, -2.0, 0.5, 0.0, 0.7, 0.0, 0.0], dtype=torch.float64)
    linear.rng = np.random.default_rng(5)
    unseen, _, _ = linear.judged(truth)
    measured = linear.columns @ truth + torch.from_numpy(np.random.default_rng(5).normal(size=20))
    for i in range(N_CAUSES):
        both = [*range(N_OWN), N_OWN + i]
        columns = linear.columns[:, both]
        covariance = torch.linalg.inv(columns.T @ columns + linear.prior[both][:, both])
        assert float(unseen.sd[i]) == pytest.approx(float(covariance[-1, -1]) ** 0.5, rel=1e-9)
        assert float(unseen.size[i]) == pytest.approx(
            float((covariance @ columns.T @ measured)[-1]), rel=1e-9
        )
        follows = covariance[:N_OWN, -1] / covariance[-1, -1]  # how parameters move against the quantity
        errors = -(linear.wanted[:, OWN] @ follows) * -1.0
        assert torch.allclose(unseen.errors[0][:, i], errors, rtol=1e-8)


def test_a_quantity_that_readings_hardly_show_keeps_its_odds_and_a_clear_one_is_sure():
    nothing = torch.zeros(N_OWN + N_CAUSES, N_OWN + N_CAUSES, dtype=torch.float64)
    linear = Linear.drawn(2, 1)
    before = Unseen.of(nothing, nothing[0], linear.prior, [linear.wanted], OWN)
    assert before.probability.tolist() == pytest.approx([ODDS / (1.0 + ODDS)] * N_CAUSES)
    assert torch.allclose(before.mean_square(), before.probability)
    clear, _, _ = Linear.drawn(3, 200).judged(torch.tensor([0.0] * 4 + [1.0] + [0.0] * 2).double())
    assert float(clear.probability[1]) > SURE
    assert float(clear.mean_square()[1]) == pytest.approx(1.0, abs=0.3)
    assert float(clear.mean_square(4.0)[1]) == float(clear.mean_square()[1])  # more stops do not lessen it
    assert float(clear.mean_square(4.0)[2]) == pytest.approx(0.25 * float(clear.mean_square()[2]))


def test_goals_are_kept_beside_a_hidden_quantity_which_the_fit_alone_does_not_keep():
    kept: dict[tuple[bool, bool], list[bool]] = {}
    for seed in range(N_SESSIONS):
        for hidden in (False, True):
            whole = Linear.drawn(seed, 120)
            truth = torch.from_numpy(whole.rng.normal(size=N_OWN + N_CAUSES))
            truth[~OWN] = 0.0
            if hidden:
                truth[N_OWN + seed % N_CAUSES] = whole.rng.choice([-1.0, 1.0]) * whole.rng.uniform(0.5, 2.0)
            for beside in (False, True):  # the session ends where the goal is reached, or not at all
                for n in range(8, 121, 8):
                    some = Linear(whole.columns[:n], whole.prior, whole.wanted, np.random.default_rng(seed))
                    unseen, error, variance = some.judged(truth)
                    if beside:
                        variance = variance + unseen.variances(unseen.mean_square(), [False]).amax()
                    if float(variance) <= TARGET:
                        is_kept = float(error.square().mean()) <= 1.645**2 * TARGET
                        kept.setdefault((hidden, beside), []).append(is_kept)
                        break
    shares = {which: float(np.mean(each)) for which, each in kept.items()}
    assert shares[False, False] > 0.9
    assert shares[False, True] > 0.9
    assert shares[True, True] > 0.8
    assert shares[True, False] < 0.6
    assert len(kept[False, True]) > 0.9 * N_SESSIONS


def test_promises_beside_what_every_device_has_are_kept_more_often():
    broken, ends = {False: 0, True: 0}, {False: 0, True: 0}
    for seed in range(60):
        whole = Linear.drawn(seed, 240)
        truth = torch.from_numpy(whole.rng.normal(size=N_OWN + N_CAUSES))
        truth[~OWN] = 0.0
        truth[3] = whole.rng.choice([-1.0, 1.0]) * whole.rng.uniform(0.3, 0.8)  # a small one, easily unseen
        for is_usual in (False, True):
            usual = torch.tensor([is_usual, False, False, False])
            for n in range(8, 241, 8):
                some = Linear(whole.columns[:n], whole.prior, whole.wanted, np.random.default_rng(seed))
                unseen, error, variance = some.judged(truth, usual)
                if float(variance + unseen.variances(unseen.mean_square(), [False]).amax()) <= 4.0 * TARGET:
                    broken[is_usual] += float(error.square().mean()) > 1.645**2 * 4.0 * TARGET
                    ends[is_usual] += 1
                    break
    assert broken[True] <= 0.1 * ends[True]
    assert broken[False] > 2 * broken[True]
    assert ends[True] > 0.5 * ends[False]


@pytest.mark.parametrize("widest", [False, True])
def test_a_goal_of_the_widest_interval_takes_the_largest_error(widest):
    unseen, _, _ = Linear.drawn(4, 30).judged(torch.zeros(N_OWN + N_CAUSES, dtype=torch.float64))
    square = unseen.errors[0].square()
    expected = (square.amax(0) if widest else square.mean(0)) * unseen.sd.square()
    assert torch.allclose(unseen.variances(unseen.sd.square(), [widest])[0], expected)
    some = torch.tensor([True, False, True, False])
    among = unseen.among(some)
    assert torch.equal(among.variances(among.sd.square(), [widest])[0], expected[some])


@pytest.mark.whole
def test_ordinary_causes_are_those_that_one_moment_shows(small_rig, small_plan):
    stops = clear_candidates(small_plan, small_rig, 0)
    rules = MeasurementModel.build(small_rig, stops).rules
    names = {cause.name for cause in with_ordinary(small_rig, stops, rules).effects}
    assert names >= {"axis_gain", "cross_axis", "robot_scale", "mount_tilt", "sensor_misplaced"}
    assert not names & {"backlash", "offset_drift", "current_remanence"}  # time and order
    assert not names & {"iron_plate", "winding_misstated", "axial_pitch"}  # shapes, and what is built in
    assert all(
        not any(q.is_shape for q in EFFECTS[name].quantities(EFFECTS[name].extent_of(()))) for name in names
    )


@pytest.mark.parametrize("size", [0.0, 2.0, 3.5])
def test_the_variance_of_what_may_be_there_is_that_of_its_draws(size):
    one = torch.ones(1, dtype=torch.float64)
    unseen = Unseen([], 0.1 * one, 0.1 * size * one, 1.0 * one, one == 0.0)
    rng = np.random.default_rng(4)
    is_there = rng.random(400_000) < float(unseen.probability)
    drawn = is_there * (0.1 * size + 0.1 * rng.normal(size=len(is_there)))
    assert float(unseen.variance) == pytest.approx(drawn.var(), rel=0.02)
