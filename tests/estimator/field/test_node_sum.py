"""The weighted sum of loops, in machine code and by torch, and its first derivatives."""

from __future__ import annotations

import numba
import pytest
import torch
from torch import Tensor
from torch.autograd import forward_ad
from torch.func import jacfwd

from estimator.field import machine_code
from estimator.field.kernel import slopes_of_loops
from estimator.field.loop import loop_field
from estimator.field.machine_code import is_plain
from estimator.field.node_sum import (
    Nodes,
    carrying_first_order,
    field_and_slopes_by_torch,
    loop_slopes,
    sum_over_nodes,
    sum_to_first_order,
)


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


@pytest.mark.parametrize("axis_m", [0.0, 1e-13, 1e-6, 0.02, 0.3], ids=lambda m: f"{m:g} m from the axis")
def test_sum_to_first_order_has_the_value_and_the_derivatives_of_the_plain_one(axis_m):
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


def test_machine_code_and_torch_give_the_same_sum_and_the_same_slopes():
    """For numbers of any rows, nodes and points; torch takes over where a derivative is wanted."""
    for rows, n_nodes, n_points in ((1, 1, 1), (2, 7, 63), (3, 20, 64), (1, 5, 65), (2, 3, 300)):
        points_m = random(rows, n_points, 3, seed=n_points) - 0.5
        nodes = Nodes(
            *(random(rows, n_nodes, seed=seed) + shift for seed, shift in ((1, -0.5), (2, 0.01), (3, 0.0)))
        )
        watched = Nodes(*(value.clone().requires_grad_() for value in nodes))
        torch.testing.assert_close(
            sum_over_nodes(points_m, nodes, 5),
            sum_over_nodes(points_m, watched, 5).detach(),
            rtol=1e-13,
            atol=1e-20,
        )
        with torch.no_grad():
            quick = slopes_of_loops(points_m, nodes.height_m, nodes.radius_m, 5)
        plain = torch.func.vmap(lambda at, w: loop_slopes(at, w.flat().height_m, w.flat().radius_m, 5))(
            points_m[:, None], watched_rows(nodes)
        )
        torch.testing.assert_close(quick, plain[:, :, 0].movedim(0, 1), rtol=1e-12, atol=1e-18)


def watched_rows(nodes: Nodes) -> Nodes:
    """Every row alone, for a map over rows."""
    return Nodes(*(value[:, None] for value in nodes))


def test_kernels_take_numbers_without_derivatives_only():
    one = torch.ones(2, dtype=torch.float64)
    with torch.no_grad():
        assert is_plain(one.clone().requires_grad_())
    assert not is_plain(one, one.clone().requires_grad_())
    seen = []
    jacfwd(lambda at: seen.append(is_plain(at)) or at)(one)
    torch.func.vmap(lambda at: seen.append(is_plain(at)) or at)(one)
    with forward_ad.dual_level():
        seen.append(is_plain(forward_ad.make_dual(one, one)))
    assert seen == [False, False, False]


def test_where_no_folder_can_be_written_the_kernels_are_translated_in_every_process(monkeypatch):
    translate = numba.njit

    def refuses_a_cache(**settings):
        if settings.get("cache"):
            raise RuntimeError("cannot cache function: no locator available")
        return translate(**settings)

    monkeypatch.setattr(numba, "njit", refuses_a_cache)
    assert machine_code.machine_code(lambda x: x + 1.0)(2.0) == 3.0


def test_machine_code_and_torch_give_the_same_field_and_slopes_of_summed_factors():
    points_m, sums = random(2, 1, 40, 3) - 0.5, random(2, 2, 3, 2, 40, seed=1) - 0.5
    points_m[0, 0, 0, :2] = 0.0  # on the axis
    free_m = points_m.clone().requires_grad_()
    field = carrying_first_order(free_m, sums)
    value, slopes = field_and_slopes_by_torch(points_m[..., :2], sums)
    assert torch.allclose(field.detach(), value, rtol=1e-15, atol=0.0)
    weight = random(*field.shape, seed=2) - 0.5
    (gradient,) = torch.autograd.grad(field, free_m, weight)
    of_slopes = (weight[..., None] * slopes).sum(-2).sum(1, keepdim=True)
    assert torch.allclose(gradient, of_slopes, rtol=1e-12, atol=1e-12 * float(of_slopes.abs().max()))
