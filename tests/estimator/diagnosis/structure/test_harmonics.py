"""Gradients of harmonic polynomials: their number, and zero divergence and curl."""

from __future__ import annotations

import pytest
import torch
from torch.func import jacfwd, vmap

from estimator.diagnosis.structure.curves import harmonic_gradients


@pytest.mark.parametrize("degree", [1, 2, 3, 4, 5])
def test_fields_obey_maxwells_equations_without_sources(degree):
    points = torch.randn(6, 3, generator=torch.Generator().manual_seed(degree), dtype=torch.float64)
    slope = vmap(jacfwd(lambda p: harmonic_gradients(p[None], degree)[0]))(
        points
    )  # point, term, component, axis
    assert slope.shape[1] == 2 * degree + 1
    divergence = torch.diagonal(slope, dim1=-2, dim2=-1).sum(-1)
    torch.testing.assert_close(divergence, torch.zeros_like(divergence), rtol=0.0, atol=1e-10)
    torch.testing.assert_close(slope, slope.mT, rtol=0.0, atol=1e-10)


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_fields_are_independent(degree):
    points = torch.randn(40, 3, generator=torch.Generator().manual_seed(7), dtype=torch.float64)
    flat = harmonic_gradients(points, degree).movedim(1, 0).flatten(1)
    assert int(torch.linalg.matrix_rank(flat)) == 2 * degree + 1
