"""Straight wires: next to the wire, on its extension, without length, and a second library."""

from __future__ import annotations

import magpylib
import mpmath
import numpy as np
import pytest
import torch
from torch import Tensor

from estimator.derivatives import jacobian_of
from estimator.field.straight import MU0_OVER_4PI, along_wire, segment_field

MAGPYLIB_OVER_OURS = 4e-7 * np.pi / (4.0 * np.pi * MU0_OVER_4PI)  # it keeps the mu0 of before 2019


def tensor(value: object) -> Tensor:
    return torch.tensor(value, dtype=torch.float64)


def test_field_is_that_of_magpylib():
    random = np.random.default_rng(0)
    start_m, end_m = random.uniform(-0.1, 0.1, (2, 3))
    points_m = random.uniform(-0.2, 0.2, (50, 3))
    wire = magpylib.current.Polyline(current=1.0, vertices=[start_m, end_m])
    expected_T = wire.getB(points_m) / MAGPYLIB_OVER_OURS
    field_T = segment_field(*map(tensor, (points_m, start_m, end_m))).numpy()
    np.testing.assert_allclose(field_T, expected_T, rtol=0.0, atol=2e-9 * np.abs(expected_T).max())


@pytest.mark.parametrize("along_m", [0.0, 0.03, 0.0499, 0.0501, 0.2])
@pytest.mark.parametrize("beside_m", [1e-9, 1e-6, 1e-3, 0.5])
def test_all_digits_beside_the_wire_and_its_extension(along_m, beside_m):
    """Against the same integral with 60 digits; the points' own digits are the exact ones of the double numbers."""
    half_m = 0.05
    with mpmath.workdps(60):
        u, q, h = mpmath.mpf(along_m), mpmath.mpf(beside_m) ** 2, mpmath.mpf(half_m)
        sines = ((u + h) / mpmath.sqrt((u + h) ** 2 + q), (u - h) / mpmath.sqrt((u - h) ** 2 + q))
        expected = float((sines[0] - sines[1]) / q)
    found = along_wire(*map(tensor, (along_m, beside_m**2, half_m)))
    assert found.item() == pytest.approx(expected, rel=1e-13)
    points_m = tensor([[0.0, beside_m, along_m]])
    field_T = segment_field(points_m, tensor([0.0, 0.0, -half_m]), tensor([0.0, 0.0, half_m]))
    assert field_T[0, 0].item() == pytest.approx(-MU0_OVER_4PI * beside_m * expected, rel=1e-13)


def test_a_wire_without_length_has_no_field_but_a_derivative():
    point_m, start_m = tensor([[0.01, 0.02, 0.0]]), tensor([0.0, 0.0, 0.0])
    jacobian = jacobian_of(lambda end_m: segment_field(point_m, start_m, end_m)[0], start_m)
    arm = point_m[0]
    element = MU0_OVER_4PI * torch.linalg.cross(torch.eye(3).double(), arm.expand(3, 3)) / arm.norm() ** 3
    torch.testing.assert_close(jacobian, element.T)


def test_on_the_extension_itself_there_is_no_field_and_derivatives_are_finite():
    end_m = tensor([0.1, 0.0, 0.0])
    jacobian = jacobian_of(lambda p: segment_field(p[None], 0.0 * end_m, end_m)[0], tensor([0.3, 0.0, 0.0]))
    assert torch.isfinite(jacobian).all()
    assert (segment_field(tensor([[0.3, 0.0, 0.0]]), 0.0 * end_m, end_m) == 0.0).all()
