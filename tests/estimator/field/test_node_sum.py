"""The weighted sum of loops, and what it becomes with and without a compiler."""

from __future__ import annotations

import subprocess
import sys

import pytest
import torch
from torch import Tensor
from torch.func import jacfwd

from estimator.field import node_sum
from estimator.field.loop import loop_field
from estimator.field.node_sum import Nodes, compiled_sum, sum_over_nodes, sum_to_first_order


def random(*shape: int, seed: int = 0) -> Tensor:
    return torch.rand(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def test_sum_is_that_of_the_weighted_loops_of_every_row():
    points_m = random(2, 5, 3) - 0.5
    nodes = Nodes(random(2, 4, seed=1) - 0.5, 0.01 + random(2, 4, seed=2), random(2, 4, seed=3) - 0.3)
    expected = torch.zeros(2, 5, 3, dtype=torch.float64)
    for row in range(2):
        for height_m, radius_m, weight in zip(*(value[row] for value in nodes), strict=True):
            lifted = torch.stack((torch.zeros_like(height_m), torch.zeros_like(height_m), height_m))
            expected[row] += weight * loop_field(points_m[row] - lifted, radius_m)
    torch.testing.assert_close(sum_over_nodes(points_m, nodes, 8), expected, rtol=1e-12, atol=1e-20)


def test_without_a_working_compiler_the_eager_sum_is_used_and_the_log_says_so(monkeypatch, caplog):
    def fails(*_: object, **__: object) -> None:
        raise RuntimeError("no C++ compiler")

    try_again = compiled_sum.__wrapped__
    for compile_ in (fails, lambda *_, **__: fails):
        caplog.clear()
        monkeypatch.setattr(torch, "compile", compile_)
        assert try_again() is node_sum.sum_over_nodes
        assert "not compiled on this machine" in caplog.text


def test_compiler_is_tried_once_in_a_process(monkeypatch):
    calls = []
    monkeypatch.setattr(torch, "compile", lambda function, **_: calls.append(1) or function)
    compiled_sum.cache_clear()
    assert compiled_sum() is compiled_sum()
    compiled_sum.cache_clear()
    assert len(calls) == 1


IN_A_FRESH_PROCESS = """
import torch
from estimator.field.node_sum import Nodes, compiled_sum, sum_over_nodes
compiled = compiled_sum()
assert compiled is not sum_over_nodes, "not compiled"
for rows, points, nodes in ((2, 5, 7), (3, 100, 320), (32, 25, 160)):
    at = torch.rand(rows, points, 3, dtype=torch.float64)
    loops = Nodes(*(torch.rand(rows, nodes, dtype=torch.float64) for _ in range(3)))
    with torch.no_grad():
        eager, ours = (function(at, loops, 5) for function in (sum_over_nodes, compiled))
    worst = ((ours - eager).norm(dim=-1) / eager.norm(dim=-1)).max().item()
    assert worst < 1e-12, worst
print("same")
"""


@pytest.mark.slow  # 10 s, and 20 s more for the first compilation on a machine
def test_compiled_sum_equals_the_eager_one():
    """In a process of its own: type checks and warnings as errors, as here, keep torch from compiling."""
    completed = subprocess.run(
        [sys.executable, "-c", IN_A_FRESH_PROCESS], capture_output=True, text=True, check=False
    )
    assert completed.stdout.strip() == "same", completed.stderr


@pytest.mark.parametrize("axis_m", [0.0, 1e-13, 1e-6, 0.02, 0.3], ids=lambda m: f"{m:g} m from the axis")
def test_sum_to_first_order_has_the_value_and_the_derivatives_of_the_plain_one(axis_m: float):
    """In the points, and in height, radius and weight of every loop, on the axis and off it."""
    points_m = random(2, 5, 3) - 0.5
    points_m[..., :2] *= axis_m
    nodes = Nodes(0.1 * random(2, 3, 1, seed=1), 0.1 + random(2, 1, 2, seed=2), random(2, 3, 2, seed=3) - 0.3)
    given = (points_m, *nodes)
    plain, quick = (
        lambda *at, f=function: f(at[0], Nodes(*at[1:]), 8)
        for function in (sum_over_nodes, sum_to_first_order)
    )
    torch.testing.assert_close(quick(*given), plain(*given), rtol=1e-13, atol=1e-22)
    for i in range(4):
        expected, derivative = (jacfwd(f, argnums=i)(*given) for f in (plain, quick))
        torch.testing.assert_close(derivative, expected, rtol=1e-10, atol=1e-12 * float(expected.abs().max()))
