"""Fields of solid harmonics: no divergence, no curl, their number, their size at the edge, and known cases."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch
from scipy.integrate import lebedev_rule
from torch import Tensor
from torch.func import jvp

from estimator.field.harmonics import exterior_field, interior_field
from estimator.rig.harmonic_terms import HIGHEST_DEGREE, terms

Field = Callable[[Tensor, dict[int, Tensor]], Tensor]
DEGREES = (1, 2, 3, 4, 5)


def each_of(field: Field, points: Tensor, degree: int) -> Tensor:
    """Term, point, component."""
    return field(points, {degree: torch.eye(2 * degree + 1, dtype=torch.float64)})


@pytest.mark.parametrize("field", [interior_field, exterior_field])
@pytest.mark.parametrize("degree", [*DEGREES, HIGHEST_DEGREE])
def test_fields_have_neither_divergence_nor_curl(field, degree):
    points = torch.randn(7, 3, generator=torch.Generator().manual_seed(degree), dtype=torch.float64)
    points = points / points.norm(dim=-1, keepdim=True) * torch.linspace(0.8, 1.2, 7)[:, None]
    along = [axis.expand_as(points) for axis in torch.eye(3, dtype=torch.float64)]
    slopes = [jvp(lambda p: each_of(field, p, degree), (points,), (axis,))[1] for axis in along]
    slope = torch.stack(slopes, dim=-1)  # term, point, component, axis
    largest = float(slope.abs().max())
    assert largest > 0.1 or degree == 1
    assert float(torch.diagonal(slope, dim1=-2, dim2=-1).sum(-1).abs().max()) < 1e-12 * max(largest, 1.0)
    assert float((slope - slope.mT).abs().max()) < 1e-12 * max(largest, 1.0)


@pytest.mark.parametrize("field", [interior_field, exterior_field])
@pytest.mark.parametrize("degree", DEGREES)
def test_terms_are_orthogonal_and_of_rms_one_at_the_edge(field, degree):
    """By Lebedev's rule, which is exact there, so that equal widths prefer no direction."""
    points, weights = (torch.from_numpy(np.ascontiguousarray(a)) for a in lebedev_rule(15))
    fields = each_of(field, points.T, degree)
    overlap = torch.einsum("p,tpi,upi->tu", weights, fields, fields) / (4.0 * np.pi)
    torch.testing.assert_close(
        overlap, torch.eye(len(terms(degree)), dtype=torch.float64), rtol=0.0, atol=1e-12
    )


def test_exterior_degree_one_is_a_dipole():
    points = torch.randn(5, 3, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    moment = torch.tensor([0.3, -0.2, 0.7], dtype=torch.float64)
    r2 = points.square().sum(-1, keepdim=True)
    dipole_T = (r2 * moment - 3.0 * points * (points @ moment)[:, None]) * r2**-2.5
    z, x, y = (float(moment[i]) for i in (2, 0, 1))
    amplitude = np.sqrt(2.0) * torch.tensor(
        [z, x, y], dtype=torch.float64
    )  # rms of a unit dipole at the unit sphere
    torch.testing.assert_close(exterior_field(points, {1: amplitude}), dipole_T, rtol=1e-12, atol=1e-14)


def test_a_batch_of_amplitudes_is_a_loop():
    points = torch.randn(4, 3, generator=torch.Generator().manual_seed(5), dtype=torch.float64)
    amplitudes = {
        d: torch.randn(6, 2 * d + 1, generator=torch.Generator().manual_seed(d)).double() for d in (2, 4)
    }
    for field in (interior_field, exterior_field):
        together = field(points, amplitudes)
        alone = [field(points, {d: a[i] for d, a in amplitudes.items()}) for i in range(6)]
        torch.testing.assert_close(together, torch.stack(alone), rtol=1e-12, atol=1e-14)
