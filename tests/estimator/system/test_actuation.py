"""Currents for what is wanted: exact, smallest, within bounds, and with derivatives."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.optimize import minimize
from torch import Tensor

from estimator.errors import InvalidInput
from estimator.system.actuation import (
    bounded_currents,
    force_matrix,
    independent_entries,
    minimum_norm_currents,
)


def random(*shape: int, seed: int = 0) -> Tensor:
    return torch.from_numpy(np.random.default_rng(seed).normal(size=shape))


def test_more_coils_than_rows_meet_the_target_with_the_smallest_currents():
    matrix, target = random(5, 3, 6), random(5, 3, seed=1)
    currents_A = minimum_norm_currents(matrix, target)
    torch.testing.assert_close((matrix @ currents_A[..., None])[..., 0], target)
    idle = torch.linalg.svd(matrix).Vh[:, 3:]  # changes nothing at the points
    assert (idle @ currents_A[..., None]).abs().max() < 1e-12


def test_fewer_coils_than_rows_come_closest():
    matrix, target = random(4, 3, 2), random(4, 3, seed=1)
    left = target - (matrix @ minimum_norm_currents(matrix, target)[..., None])[..., 0]
    assert (matrix.mT @ left[..., None]).abs().max() < 1e-12


def test_currents_carry_the_derivative_of_the_target_and_of_the_matrix():
    matrix, target = random(3, 4).requires_grad_(), random(3, seed=1).requires_grad_()
    assert torch.autograd.gradcheck(minimum_norm_currents, (matrix, target))


def test_bounds_hold_and_nothing_within_them_comes_closer():
    matrix, target = 1e-3 * random(8, 3, 5), 5e-3 * random(8, 3, seed=1)
    most_A = torch.tensor([1.0, 2.0, 0.5, 1.0, 3.0], dtype=torch.float64)
    currents_A = bounded_currents(matrix, target, most_A)
    assert (currents_A.abs() <= most_A + 1e-9).all()
    assert (currents_A.abs() > most_A - 1e-9).any(-1).sum() > 3  # the bounds matter here
    for at_point, wanted, bounded_A in zip(matrix.numpy(), target.numpy(), currents_A.numpy(), strict=True):
        rival = minimize(
            lambda i, a=at_point, b=wanted: 1e6 * ((a @ i - b) ** 2).sum(),
            np.zeros(5),
            bounds=[(-m, m) for m in most_A.tolist()],
            options={"ftol": 1e-15, "gtol": 1e-10},
        )
        assert 1e6 * ((at_point @ bounded_A - wanted) ** 2).sum() < rival.fun + 1e-9


def test_bounds_that_do_not_bind_leave_the_smallest_currents():
    matrix, target = random(4, 3, 6), random(4, 3, seed=1)
    wide_A = torch.full((6,), 1e6, dtype=torch.float64)
    assert torch.equal(bounded_currents(matrix, target, wide_A), minimum_norm_currents(matrix, target))


def test_unknown_rows_give_unknown_currents_and_leave_the_others():
    matrix, target = random(3, 3, 4), random(3, 3, seed=1)
    holed = matrix.clone()
    holed[1, 0, 0] = torch.nan
    for most_A in (None, 0.3):
        if most_A is None:
            holed_A, whole_A = (minimum_norm_currents(m, target) for m in (holed, matrix))
        else:
            bound = torch.full((4,), most_A, dtype=torch.float64)
            holed_A, whole_A = (bounded_currents(m, target, bound) for m in (holed, matrix))
        assert torch.isnan(holed_A[1]).all()
        torch.testing.assert_close(holed_A[[0, 2]], whole_A[[0, 2]])


@pytest.mark.parametrize("bound", [0.0, -1.0, float("nan")])
def test_bounds_that_are_not_positive_are_refused(bound):
    with pytest.raises(InvalidInput, match="largest currents must be > 0"):
        bounded_currents(random(3, 1), random(3), torch.tensor([bound], dtype=torch.float64))


def test_force_per_ampere_is_the_moment_times_the_whole_gradient():
    raw = random(6, 3, 3)
    gradient = raw + raw.mT
    gradient = gradient - torch.eye(3) * gradient.diagonal(dim1=-2, dim2=-1).sum(-1)[:, None, None] / 3.0
    rows = torch.cat((torch.zeros(6, 3).double(), independent_entries(gradient)), dim=-1)[..., None]
    moment = random(6, 3, seed=1)
    expected = torch.einsum("pi,pij->pj", moment, gradient)
    torch.testing.assert_close(force_matrix(rows, moment)[..., 0], expected)
