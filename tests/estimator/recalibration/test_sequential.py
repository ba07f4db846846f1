"""Error rates of the sequential test hold by simulation, also where each stop is chosen by the readings before it."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from estimator.recalibration.sequential import Innovations, Rates

N_SESSIONS, MOST_STOPS = 150, 40
RATES = Rates(false_alarms=0.05, misses=0.1)
SIZE = 0.6
SIZES = torch.full((5,), SIZE, dtype=torch.float64)


class Rig:
    """A linear calibration of three uncertain parameters, and five changes, one of them nearly a parameter."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.covariance = torch.diag(torch.tensor([1.0, 0.3, 0.1], dtype=torch.float64))
        self.places = torch.from_numpy(np.random.default_rng(1).normal(size=(30, 3, 8)))
        self.places[..., 3] = self.places[..., 0] + self.places[..., 3]
        self.true = torch.from_numpy(self.rng.normal(size=3)) @ self.covariance.sqrt()

    def ended(self, change: int | None, scatter: float = 0.0) -> tuple[str, int]:
        """How a session ends whose next stop is where the leading change shows most, and after how many stops."""
        columns, shown = torch.zeros(0, 8).double(), torch.zeros(0).double()
        place = 0
        for n in range(1, MOST_STOPS + 1):
            here = self.places[place]
            noise = self.rng.normal(size=3) * np.sqrt(1.0 + scatter**2)
            added = 0.0 if change is None else SIZE * here[:, 3 + change]
            columns = torch.cat((columns, here))
            shown = torch.cat((shown, here[:, :3] @ self.true + added + torch.from_numpy(noise)))
            ratios = self.innovations(shown, columns).log_ratios(SIZES)
            if RATES.holds(ratios):
                return "holds", n
            if RATES.has_changed(ratios):
                return "changed", n
            leading = int(ratios[:-1].argmax())
            place = int((self.places[..., 3 + leading].square().sum(-1) * torch.rand(30)).argmax())
        return "undecided", MOST_STOPS

    def innovations(self, shown: Tensor, columns: Tensor) -> Innovations:
        scatter = torch.full_like(shown, 1.0)
        return Innovations.of(shown, columns[:, :3], self.covariance, columns[:, 3:], scatter)


@pytest.mark.parametrize(("change", "scatter"), [(None, 0.0), (0, 0.0), (None, 1.0)])
def test_error_rates_hold(change, scatter):
    torch.manual_seed(0)
    ends = [Rig(seed).ended(change, scatter) for seed in range(N_SESSIONS)]
    share = {word: sum(end == word for end, _ in ends) / N_SESSIONS for word in ("holds", "changed")}
    if change is None and not scatter:
        assert share["changed"] <= RATES.false_alarms + 0.03
        assert share["holds"] > 0.9
    else:
        assert share["holds"] <= RATES.misses + 0.04
        assert share["changed"] > 0.8
    assert np.mean([n for _, n in ends]) < 0.6 * MOST_STOPS


def test_a_calibration_that_is_taken_as_exact_gives_false_alarms():
    exact = [Rig(seed) for seed in range(40)]
    for rig in exact:
        rig.covariance = rig.covariance * 1e-9  # while the truth is drawn from the wide one
    assert sum(rig.ended(None)[0] == "changed" for rig in exact) > 20


def test_later_readings_leave_earlier_numbers_as_they_are():
    rig = Rig(3)
    columns = rig.places[:6].flatten(0, 1)
    shown = torch.from_numpy(rig.rng.normal(size=18))
    whole, first = rig.innovations(shown, columns), rig.innovations(shown[:9], columns[:9])
    assert torch.allclose(whole.residual[:9], first.residual, rtol=1e-12)
    assert torch.allclose(whole.columns[:9], first.columns, rtol=1e-12)


def test_the_ratio_is_that_of_normal_densities():
    rig = Rig(4)
    columns = rig.places[:4].flatten(0, 1)
    shown = torch.from_numpy(rig.rng.normal(size=12))
    own, change = columns[:, :3], columns[:, 5]
    spread = own @ rig.covariance @ own.T + torch.eye(12).double()

    def density(mean: Tensor) -> float:
        normal = torch.distributions.MultivariateNormal(mean, spread)
        return float(normal.log_prob(shown).exp())

    expected = 0.5 * (density(SIZE * change) + density(-SIZE * change)) / density(0.0 * change)
    ratios = rig.innovations(shown, columns).log_ratios(SIZES)
    assert float(ratios[2].exp()) == pytest.approx(expected, rel=1e-9)
