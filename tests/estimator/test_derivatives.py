"""Jacobians path by path: the same numbers, and no path visits what only another one acts through."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
import torch
from torch import Tensor

from estimator.derivatives import jacobian_of, value_and_jacobian_by_paths

POINT = torch.tensor([0.3, -1.2, 2.0, 0.7], dtype=torch.float64)
EVERY = torch.eye(4, dtype=torch.float64)


def entangled(x: Sequence[Tensor]) -> Tensor:
    return torch.stack((x[0] * x[1].sin(), x[1] ** 2 * x[2], x[3].exp(), x[0] + x[3] * x[2]))


@pytest.mark.parametrize("paths", [[[0, 1, 2, 3]], [[0], [1], [2], [3]], [[2, 0], [3, 1]]])
def test_paths_do_not_change_the_derivatives(paths):
    values, along = value_and_jacobian_by_paths(entangled, POINT, EVERY, paths)
    assert torch.equal(values, entangled(POINT.unbind()))
    assert torch.allclose(along, jacobian_of(lambda x: entangled(x.unbind()), POINT), atol=1e-14)


def test_a_path_visits_nothing_that_only_others_act_through():
    visited: list[str] = []

    def watched(name: str, x: Tensor) -> Tensor:
        x = 1.0 * x
        x.register_hook(lambda gradient: gradient.register_hook(lambda _: visited.append(name)) and None)
        return x**2

    def apart(x: Sequence[Tensor]) -> Tensor:
        return watched("first", x[0]) + watched("second", x[1])

    value_and_jacobian_by_paths(apart, POINT[:2], torch.eye(2).double(), [[0], [1]])
    assert sorted(visited) == [
        "first",
        "second",
    ]  # once each: by one pass for both, each would be visited by both


def test_what_changes_nothing_has_derivatives_of_zero():
    _, along = value_and_jacobian_by_paths(lambda x: x[0] * torch.ones(3), POINT, EVERY, [[0, 1], [2, 3]])
    assert along.tolist() == [[1.0, 0.0, 0.0, 0.0]] * 3
    _, none = value_and_jacobian_by_paths(lambda x: torch.ones(3), POINT, EVERY, [[0, 1, 2, 3]])
    assert none.tolist() == [[0.0] * 4] * 3
