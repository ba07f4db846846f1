"""Alarms: soon where something changed, with the reading since when; next to none in noise."""

from __future__ import annotations

import pytest
import torch

from estimator.inference.linearisation import Innovation
from estimator.live.watch import ALONG, Alarm, Watch
from estimator.readings.observations import Observations
from estimator.rig.rig import Rig

SIGMA_T = 5e-6
N = 400


def watched(rig: Rig, change: torch.Tensor, seed: int, expected_T: torch.Tensor | None = None) -> list[Alarm]:
    """Alarms about noise with a change added, in units of sigma, reading by component."""
    watch = Watch(rig)
    noise = torch.randn(N, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64) + change
    for number in range(N):
        field_T = torch.zeros(1, 3, dtype=torch.float64)
        readings = Observations.of(torch.zeros(1, 1).double(), {"arm1": torch.zeros(1, 6).double()}, field_T)
        here_T = field_T if expected_T is None else expected_T[number][None]
        sigma_T, known = (
            torch.full((3,), SIGMA_T, dtype=torch.float64),
            torch.zeros(1, 1, dtype=torch.float64),
        )
        innovation = Innovation(SIGMA_T * noise[number], sigma_T, known.expand(3, 1), known, here_T)
        watch.look(innovation, readings, number + 1)
    return watch.alarms


def test_noise_raises_no_alarm(small_rig):
    assert [alarm for seed in range(5) for alarm in watched(small_rig, torch.zeros(N, 3), seed)] == []


@pytest.mark.parametrize("seed", range(5))
def test_a_shift_is_found_soon_and_dated(small_rig, seed):
    change = torch.zeros(N, 3)
    change[209:, 1] = -1.5
    (alarm, *_) = watched(small_rig, change, seed)
    assert (alarm.sensor, alarm.what) == ("hall", "y")
    assert alarm.since == pytest.approx(210, abs=15)
    assert alarm.since < alarm.at < 240
    assert alarm.size_sigma == pytest.approx(-1.5, abs=0.9)


def test_a_field_that_weakens_is_told_from_a_component_that_is_off(small_rig):
    """The field points another way at each reading, so that only its strength is off the same way."""
    direction = torch.randn(N, 3, generator=torch.Generator().manual_seed(9), dtype=torch.float64)
    direction = direction / direction.norm(dim=1, keepdim=True)
    change = torch.zeros(N, 3, dtype=torch.float64)
    change[100:] = -2.0 * direction[100:]
    alarms = watched(small_rig, change, 1, 1e-3 * direction)
    assert [alarm.what for alarm in alarms] == [ALONG]
    assert alarms[0].since == pytest.approx(101, abs=8)


def test_one_improbable_reading_is_one_alarm(small_rig):
    change = torch.zeros(N, 3)
    change[49, 2] = 9.0
    (alarm,) = watched(small_rig, change, 3)
    assert (alarm.since, alarm.at) == (50, 50)
    assert "reading 50 is improbable" in alarm.words


def test_readings_that_arrive_together_are_expected_by_those_before_them():
    """One after the other they are independent: the factors of their joint density multiply."""
    generator = torch.Generator().manual_seed(4)
    jacobian_T, root = (torch.randn(n, 3, generator=generator, dtype=torch.float64) for n in (9, 3))
    sigma_T, covariance = torch.full((9,), 0.1, dtype=torch.float64), root @ root.mT
    difference_T = torch.randn(9, generator=generator, dtype=torch.float64)
    innovation = Innovation(difference_T, sigma_T, jacobian_T, covariance, torch.zeros(4, 3).double())
    joint_T2 = jacobian_T @ covariance @ jacobian_T.mT + torch.diag(sigma_T.square())
    each = list(innovation.one_by_one(torch.arange(9).split([3, 1, 2, 3])))
    chi2 = sum(float(d @ torch.linalg.solve(spread, d)) for d, spread in each)
    assert chi2 == pytest.approx(float(difference_T @ torch.linalg.solve(joint_T2, difference_T)))
    assert sum(float(spread.logdet()) for _, spread in each) == pytest.approx(float(joint_T2.logdet()))
