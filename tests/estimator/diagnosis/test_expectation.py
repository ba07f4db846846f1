"""Errors beside which mistakes of rows are weighed, where some components, or all fields, are missing in part of the readings."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from estimator.diagnosis.expectation import Expectation
from estimator.diagnosis.local_errors import log_density_of_wrong_model
from estimator.diagnosis.row_mistakes import Mistake
from estimator.diagnosis.row_odds import would_show
from estimator.readings.observations import Observations

NOISE_T, FIELD_T, N = 1e-6, 1e-3, 240


def readings_of(field_T: Tensor, position_m: Tensor) -> Observations:
    """Readings of one sensor, one after another."""
    motion = {"arm1": torch.nn.functional.pad(position_m, (0, 3))}
    return Observations.of(torch.ones(len(field_T), 1).double(), motion, field_T)


def random(*shape: int, seed: int) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def test_errors_are_compared_with_those_of_the_same_component():
    """A probe of one axis that is turned has one component in each reading; the model lacks iron, which moves all of them."""
    position_m = 0.03 * random(N, 3, seed=1)
    wrong_T = 3e-4 * torch.exp(-position_m.square().sum(1) / 0.03**2)[:, None].expand(-1, 3)
    field_T, axis = FIELD_T + wrong_T + NOISE_T * random(N, 3, seed=2), torch.arange(N) % 3
    turned_T = field_T.where(torch.nn.functional.one_hot(axis, 3).bool(), torch.nan)
    predicted_T = torch.full_like(field_T, FIELD_T)
    together = Expectation(readings_of(turned_T, position_m), predicted_T)
    x_only = readings_of(turned_T[axis == 0], position_m[axis == 0])
    alone = Expectation(x_only, predicted_T[axis == 0])
    alone.__dict__["size_T"] = together.size_T[axis == 0]
    density = log_density_of_wrong_model(together)[axis == 0]
    torch.testing.assert_close(density, log_density_of_wrong_model(alone))


def test_readings_without_field_say_nothing_of_errors_that_grow_with_it():
    is_on = (torch.arange(N) % 3 == 0).double()[:, None]
    predicted_T = FIELD_T * is_on.expand(-1, 3)
    expected = Expectation(
        readings_of(predicted_T + NOISE_T * random(N, 3, seed=3), random(N, 3, seed=4)), predicted_T
    )
    assert expected.size_T.tolist() == pytest.approx([NOISE_T] * N, rel=0.3)


def test_a_mistake_shows_in_what_was_measured_alone():
    predicted_T = torch.full((N, 3), FIELD_T, dtype=torch.float64)
    field_T = predicted_T + NOISE_T * random(N, 3, seed=5)
    field_T[N // 2 :, 0] = torch.nan
    expected = Expectation(readings_of(field_T, random(N, 3, seed=6)), predicted_T)
    reversed_x_T = predicted_T * torch.tensor([-1.0, 1.0, 1.0], dtype=torch.float64)
    shown = would_show(Mistake("is reversed", 0, reversed_x_T), expected)
    assert shown[: N // 2].all()
    assert not shown[N // 2 :].any()
