"""Field of magnetised rings with cheap first derivatives beside the one that autograd differentiates."""

from __future__ import annotations

import torch

from estimator.field.magnetised import Rings, field_of_rings, field_of_rings_to_first_order


def test_cheap_derivatives_in_the_points_are_those_of_the_field():
    random = torch.Generator().manual_seed(3)
    rings = Rings(
        *torch.tensor([[0.10, 0.11, 0.12], [-0.02, 0.0, 0.03], [1e-4, 2e-4, 1e-4]], dtype=torch.float64)
    )
    magnetisation_T = torch.randn(2, 3, 2, generator=random, dtype=torch.float64)
    points_m = 0.05 * torch.randn(4, 5, 3, generator=random, dtype=torch.float64)
    weight = torch.randn(4, 5, 2, 3, generator=random, dtype=torch.float64)
    found = []
    for field in (field_of_rings, field_of_rings_to_first_order):
        free_m = points_m.clone().requires_grad_()
        value = field(free_m, rings, magnetisation_T)
        (gradient,) = torch.autograd.grad((value * weight).sum(), free_m)
        found.append((value.detach(), gradient))
    (value, gradient), (cheap, cheap_gradient) = found
    assert torch.allclose(cheap, value, rtol=1e-9, atol=1e-12)
    assert torch.allclose(cheap_gradient, gradient, rtol=1e-5, atol=1e-5 * float(gradient.abs().max()))
