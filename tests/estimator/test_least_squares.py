"""Least squares are the same each time, and those of NumPy, for systems of any rank."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from estimator.least_squares import least_squares


def system(rank: int) -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(rank)
    left, right = (torch.randn(4, rank, dtype=torch.float64, generator=generator) for _ in range(2))
    return left @ right.T, torch.randn(4, dtype=torch.float64, generator=generator)


@pytest.mark.parametrize("rank", [1, 3, 4])
def test_the_shortest_solution_is_that_of_numpy(rank):
    matrix, right = system(rank)
    expected = np.linalg.lstsq(matrix.numpy(), right.numpy(), rcond=1e-12)[0]
    np.testing.assert_allclose(least_squares(matrix, right).numpy(), expected, rtol=1e-9, atol=1e-12)


def test_memory_that_was_used_before_changes_nothing() -> None:
    """With PyTorch's own choice of the driver a few hundred solutions of this system are several different ones."""
    matrix, right = system(4)
    solutions = set()
    for _ in range(300):
        torch.randint(0, 2, (4,), dtype=torch.int32)  # the memory is free again at once, but holds these
        solutions.add(tuple(least_squares(matrix, right).tolist()))
    assert len(solutions) == 1
