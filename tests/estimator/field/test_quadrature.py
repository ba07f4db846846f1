"""Gauss rules of N equal loops: exact to the degree they promise, also where N is not a whole number."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor
from torch.func import jacfwd, jacrev

from estimator.field.quadrature import discrete_gauss

COUNTS_AND_NODES = [(1, 1), (2, 1), (2, 2), (3, 2), (7, 3), (25, 6), (25, 25), (48, 10), (110, 16), (400, 24)]


def tensor(value: float) -> Tensor:
    return torch.tensor(value, dtype=torch.float64)


def positions(count: int) -> Tensor:
    """Where the loops stand, in units of their spacing."""
    return torch.arange(count, dtype=torch.float64) - 0.5 * (count - 1)


@pytest.mark.parametrize(("count", "n"), COUNTS_AND_NODES)
def test_rule_is_exact_to_degree_2n_minus_1(count, n):
    rule = discrete_gauss(tensor(count), n)
    half = max(0.5 * (count - 1), 0.5)
    for degree in range(2 * n):
        full = ((positions(count) / half) ** degree).sum().item()
        ours = (rule.weights * (rule.nodes / half) ** degree).sum().item()
        assert ours == pytest.approx(full, rel=0, abs=1e-13 * count)


@pytest.mark.parametrize(("count", "n"), [(c, n) for c, n in COUNTS_AND_NODES if n < c and n < 12])
def test_error_at_degree_2n_is_the_norm_of_the_next_orthogonal_polynomial(count, n):
    """What a Gauss rule must miss: N b_1 ... b_n, so that no wrong rule passes as exact."""
    rule = discrete_gauss(tensor(count), n)
    missed = (positions(count) ** (2 * n)).sum() - (rule.weights * rule.nodes ** (2 * n)).sum()
    norm = count * math.prod(k**2 * (count**2 - k**2) / (4 * (4 * k**2 - 1)) for k in range(1, n + 1))
    full = (positions(count) ** (2 * n)).sum().item()
    assert missed.item() == pytest.approx(norm, rel=1e-9, abs=1e-12 * full)
    assert norm > 1e-9 * full


@pytest.mark.parametrize("count", [1, 2, 3, 8, 25, 48])
def test_as_many_nodes_as_loops_is_the_full_sum(count):
    rule = discrete_gauss(tensor(count), count)
    torch.testing.assert_close(rule.nodes, positions(count), rtol=0, atol=1e-13 * count)
    torch.testing.assert_close(rule.weights, torch.ones(count, dtype=torch.float64), rtol=0, atol=1e-12)


@pytest.mark.parametrize("count", [4.0, 7.3, 24.5, 47.999])
def test_real_valued_counts_continue_the_moments_as_polynomials_in_the_count(count):
    rule = discrete_gauss(tensor(count), 4)
    moments = [(rule.weights * rule.nodes**degree).sum().item() for degree in (0, 1, 2, 3, 4)]
    square = count**2
    expected = [
        count,
        0.0,
        count * (square - 1.0) / 12.0,
        0.0,
        count * (square - 1.0) * (3.0 * square - 7.0) / 240.0,
    ]
    assert moments == pytest.approx(expected, rel=1e-12, abs=1e-9)


@pytest.mark.parametrize("count", [8.0, 24.5, 48.0])
@pytest.mark.parametrize("part", ["nodes", "weights"])
def test_derivative_in_the_count_is_the_limit_of_central_differences(count, part):
    def rule(value: Tensor) -> Tensor:
        return getattr(discrete_gauss(value, 6), part)

    def error(step: float) -> float:
        difference = (rule(tensor(count + step)) - rule(tensor(count - step))) / (2.0 * step)
        return (difference - derivative).abs().max().item()

    derivative = jacfwd(rule)(tensor(count))
    torch.testing.assert_close(jacrev(rule)(tensor(count)), derivative, rtol=1e-10, atol=1e-12)
    assert error(0.04) / error(0.02) == pytest.approx(4.0, rel=0.05)
    assert error(1e-4) < 1e-8 * derivative.abs().max().item()


@pytest.mark.parametrize(("count", "n"), [*COUNTS_AND_NODES, (24.5, 6), (5.2, 5), (47.3, 24)])
def test_nodes_ascend_inside_the_hull_of_the_loops_and_weights_are_positive(count, n):
    rule = discrete_gauss(tensor(count), n)
    assert (rule.nodes.diff() > 0).all()
    assert rule.nodes.abs().max() <= 0.5 * (count - 1) + 1e-12 * count
    assert (rule.weights > 0).all()
    torch.testing.assert_close(rule.nodes, -rule.nodes.flip(0), rtol=0, atol=1e-12 * count)
    torch.testing.assert_close(rule.weights, rule.weights.flip(0), rtol=0, atol=1e-12 * count)


def test_more_nodes_than_loops_still_give_the_full_sum():
    rule = discrete_gauss(tensor(3.0), 5)
    ours = (rule.weights * torch.exp(0.3 * rule.nodes)).sum().item()
    assert ours == pytest.approx(torch.exp(0.3 * positions(3)).sum().item(), rel=1e-9)


def test_batch_of_counts_equals_one_by_one():
    counts = torch.tensor([[7.0, 24.5, 48.0], [9.0, 10.25, 110.0]], dtype=torch.float64)
    together = discrete_gauss(counts, 6)
    assert together.nodes.shape == together.weights.shape == (2, 3, 6)
    for i in range(2):
        for j in range(3):
            alone = discrete_gauss(counts[i, j], 6)
            torch.testing.assert_close(together.nodes[i, j], alone.nodes, rtol=1e-13, atol=1e-13)
            torch.testing.assert_close(together.weights[i, j], alone.weights, rtol=1e-13, atol=1e-13)


def test_number_format_is_kept():
    for dtype in (torch.float32, torch.float64):
        for n in (1, 4):
            rule = discrete_gauss(torch.tensor(9.0, dtype=dtype), n)
            assert rule.nodes.dtype == rule.weights.dtype == dtype


def test_a_count_that_was_expanded_has_one_rule_with_the_derivatives_of_all():
    count = torch.tensor([[30.0], [7.5]], dtype=torch.float64, requires_grad=True)
    together = discrete_gauss(count.expand(2, 5), 4)
    assert together.nodes.shape == together.weights.shape == (2, 5, 4)
    assert together.nodes.stride()[1] == together.weights.stride()[1] == 0
    apart = discrete_gauss(count.detach().expand(2, 5).contiguous(), 4)
    assert torch.equal(together.nodes, apart.nodes)
    assert torch.equal(together.weights, apart.weights)
    together.weights.sum().backward()
    assert torch.allclose(count.grad, torch.full_like(count, 5.0))
