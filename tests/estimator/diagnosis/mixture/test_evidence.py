"""Evidence of items beside others: against the full normal density, and against integrals."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.integrate import quad

from estimator.diagnosis.mixture.evidence import Products
from tests.estimator.diagnosis.mixture.dictionaries import N, dictionary, item, log_density

ITEMS = [
    item("one", [0]),
    item("two", [1, 2]),
    item("five", [3, 4, 5, 6, 7], width=0.5),
    item("moved", [8], shift=9),
    item("moved both", [10, 11, 12], shift=13),
]


@pytest.mark.parametrize("chosen", [[], [0], [1, 3], [2, 4], [0, 1, 2, 3]])
def test_evidence_beside_others_is_the_ratio_of_full_densities(chosen):
    made = dictionary(ITEMS)
    beside = Products(made).beside(chosen, 1.0)
    before = log_density(made, chosen)
    for i in range(len(ITEMS)):
        if i not in chosen:
            assert float(beside[i]) == pytest.approx(log_density(made, [*chosen, i]) - before, abs=1e-8)


@pytest.mark.parametrize("noise", [0.5, 1.3])
def test_another_noise_changes_it_as_the_density_says_where_the_numbers_are_free(noise):
    made = dictionary(ITEMS, prior_precision=1e-5)
    beside = Products(made).beside([1], noise)
    expected = log_density(made, [1, 2], noise) - log_density(made, [1], noise)
    assert float(beside[2]) == pytest.approx(expected, abs=1e-3)


def test_likelihood_of_a_set_and_evidence_of_its_last_item_agree():
    products = Products(dictionary(ITEMS))
    noise = torch.tensor([0.7, 1.0, 1.4], dtype=torch.float64)
    gained = products.log_likelihood([0, 2, 3], noise) - products.log_likelihood([0, 3], noise)
    beside = [float(products.beside([0, 3], float(one))[2]) for one in noise]
    assert gained.tolist() == pytest.approx(beside, abs=1e-8)


def test_components_without_weight_are_as_if_they_had_not_been_measured():
    made = dictionary(ITEMS)
    kept = torch.arange(N) % 2 == 0
    few = replace(
        made,
        columns=made.columns[kept],
        residual=made.residual[kept],
        always=made.always.of(made.always.jacobian[kept], made.prior_precision),
    )
    by_weight, by_rows = Products(made, kept.to(torch.float64)), Products(few)
    assert by_weight.n == by_rows.n
    assert torch.allclose(by_weight.beside([0], 1.0), by_rows.beside([0], 1.0), atol=1e-9)


def test_sizes_are_those_of_a_regression_with_the_same_priors():
    made = dictionary(ITEMS)
    mean, covariance = Products(made).sizes([1, 3], 1.0)
    columns, widths = [1, 2, 8], [2.0, 3.0, 2.0]
    together = torch.cat((made.columns[:, columns], made.always.jacobian), dim=1)
    prior = torch.cat((torch.tensor(widths, dtype=torch.float64) ** -2, made.prior_precision.diagonal()))
    precision = together.T @ together + prior.diag()
    expected = torch.linalg.solve(precision, together.T @ (made.residual - made.columns[:, 9]))
    assert torch.allclose(mean, expected[:3], atol=1e-9)
    assert torch.allclose(covariance, torch.linalg.inv(precision)[:3, :3], atol=1e-9)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_what_cannot_be_negative_has_the_evidence_of_a_half_normal_prior(sign):
    half = item("half", [0], width=2.0, is_one_sided=True)
    made = dictionary([half])
    made = replace(made, residual=made.residual + sign * made.columns[:, 0])
    products = Products(made)
    gram, score = float(products.gram[0, 0]), float(products.gram[0, products.residual])

    def density(size: float) -> float:
        return (
            math.exp(score * size - 0.5 * gram * size**2)
            * math.exp(-0.125 * size**2)
            / math.sqrt(2.0 * math.pi)
        )

    integral = quad(density, 0.0, 20.0)[0]  # a half-normal of width 2 has 2 / (2 sqrt(2 pi)) at its end
    assert float(products.beside([], 1.0)[0]) == pytest.approx(np.log(integral), abs=1e-6)
