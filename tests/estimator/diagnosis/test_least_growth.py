"""The least growth of a covariance is large enough, and its dual problem proves that no other costs less."""

from __future__ import annotations

import pytest
import torch

from estimator.diagnosis.least_growth import least_growth

SIZES = torch.tensor([1e-3, 1.0, 20.0, 1e2, 1e-6, 1.0], dtype=torch.float64)


def covariance_of(seed: int) -> torch.Tensor:
    """Of six numbers of very different size, of which two are nearly each other's double."""
    generator = torch.Generator().manual_seed(seed)
    readings = torch.randn(9, 6, generator=generator, dtype=torch.float64)
    readings[:, 1] = readings[:, 0] + 1e-2 * readings[:, 1]
    return SIZES[:, None] * torch.linalg.inv(readings.T @ readings) * SIZES


@pytest.mark.parametrize("seed", range(5))
def test_no_number_is_surer_than_wanted_and_no_growth_costs_less(seed: int) -> None:
    """Multipliers y >= 0 of what the variances lack, with C^-1 - diag(y) positive semidefinite, bound every cost from below by duality."""
    covariance = covariance_of(seed)
    wanted = covariance.diagonal() * torch.tensor([4.0, 9.0, 0.5, 25.0, 1.0, 2.0], dtype=torch.float64)
    growth = least_growth(covariance, wanted) / (SIZES[:, None] * SIZES)
    lacking = ((wanted - covariance.diagonal()) / SIZES**2).clamp(min=0.0)
    assert (growth.diagonal() >= lacking * (1.0 - 1e-9)).all()
    assert torch.linalg.eigvalsh(growth).min() > -1e-9
    precision = SIZES[:, None] * torch.linalg.inv(covariance) * SIZES
    multipliers = ((precision @ growth).diagonal() / growth.diagonal()).clamp(min=0.0).sqrt()
    scaled = multipliers[:, None] * (covariance / (SIZES[:, None] * SIZES)) * multipliers
    bound = (multipliers.square() * lacking).sum() / torch.linalg.eigvalsh(scaled).max().clamp(min=1.0)
    cost = (precision @ growth).trace()
    assert 0.95 * cost < bound < 1.001 * cost


def test_variances_that_are_large_enough_stay() -> None:
    covariance = covariance_of(0)
    assert (least_growth(covariance, 0.9 * covariance.diagonal()) == 0.0).all()
