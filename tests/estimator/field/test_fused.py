"""The kernel for graphics processors says what machine code on the processor says.

It runs where COILCAL_FAR_DEVICE names a graphics processor (`make test-device`), or in Triton's interpreter (TRITON_INTERPRET=1).
"""

from __future__ import annotations

import os
from importlib.util import find_spec

import pytest
import torch
from torch.testing import assert_close

from estimator.field.fused import fused_sum_of_loops, is_fusable
from estimator.field.node_sum import Nodes, sum_over_nodes
from estimator.field.winding import Winding, winding_field_per_ampere
from estimator.field.winding_shape import Rule
from tests.far import REAL

INTERPRETED = "TRITON_INTERPRET" in os.environ
pytestmark = pytest.mark.skipif(
    not find_spec("triton") or not (REAL or INTERPRETED), reason="needs Triton and a graphics processor"
)
DEVICE = REAL or "cpu"


def loops(n_rows: int, n_nodes: int) -> Nodes:
    random = torch.Generator().manual_seed(3)
    heights, radii, weights = torch.rand(3, n_rows, n_nodes, generator=random, dtype=torch.float64)
    return Nodes(-0.05 * heights, 0.02 + 0.03 * radii, weights)


@pytest.mark.parametrize(("n_rows", "n_points", "n_nodes"), [(1, 1, 1), (3, 129, 7), (2, 300, 64), (0, 5, 3)])
@pytest.mark.parametrize("steps", [3, 5, 10])
def test_sum_is_that_of_the_processor(n_rows, n_points, n_nodes, steps):
    random = torch.Generator().manual_seed(4)
    points_m = 0.1 * torch.rand(n_rows, n_points, 3, generator=random, dtype=torch.float64)
    if points_m.numel():
        points_m[0, 0, :2] = 0.0  # on the axis
    nodes = loops(n_rows, n_nodes)
    near_T = sum_over_nodes(points_m, nodes, steps)
    largest_T = float(near_T.abs().max()) if near_T.numel() else 0.0
    for dtype, error in ((torch.float64, 4e-15), (torch.float32, 4e-6)):
        there = (value.to(DEVICE, dtype) for value in (points_m, *nodes))
        field_T = fused_sum_of_loops(*there, steps)
        assert (field_T.device.type, field_T.dtype) == (torch.device(DEVICE).type, dtype)
        assert_close(field_T.cpu().double(), near_T, rtol=0.0, atol=error * largest_T)


@pytest.mark.skipif(not REAL, reason="the interpreter's tensors are the processor's")
def test_windings_there_take_the_kernel_unless_they_carry_derivatives():
    numbers = torch.tensor([0.051, 48.0, 25.0, 0.98e-3, 0.98e-3], dtype=torch.float64)
    points_m = torch.tensor([[0.01, 0.0, 0.02], [0.0, 0.03, 0.3]], dtype=torch.float64)
    near_T = winding_field_per_ampere(points_m, Winding(*numbers), Rule(4, 4, 5))
    there = points_m.to(REAL)
    assert is_fusable(there)
    assert not is_fusable(there.clone().requires_grad_())
    field_T = winding_field_per_ampere(there, Winding(*numbers.to(REAL)), Rule(4, 4, 5))
    assert_close(field_T.cpu(), near_T, rtol=1e-13, atol=0.0)
