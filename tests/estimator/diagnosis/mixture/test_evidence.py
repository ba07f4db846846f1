"""Evidence of items beside others: against the full normal density, and against integrals."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch

from estimator.diagnosis.mixture.evidence import Beside, Products
from tests.estimator.diagnosis.mixture.dictionaries import N, dictionary, item, log_density

ITEMS = [
    item("one", [0]),
    item("two", [1, 2]),
    item("five", [3, 4, 5, 6, 7], width=0.5),
    item("moved", [8], shift=9),
    item("moved both", [10, 11, 12], shift=13),
    # Each has the columns of the one before, with other widths or another start.
    item("moved both", [10, 11, 12], width=20.0, shift=13),
    item("moved both", [10, 11, 12], width=0.1, shift=13),
    item("moved otherwise", [10, 11, 12], shift=14),
    item("at rest", [10, 11, 12]),
    item("a part", [10, 11]),
    item("a part", [10, 11], width=30.0),
]


@pytest.mark.parametrize("chosen", [[], [0], [1, 3], [2, 4], [0, 1, 2, 3]])
def test_evidence_beside_others_is_the_ratio_of_full_densities(chosen):
    made = dictionary(ITEMS)
    beside = Products(made).beside(chosen, 1.0)
    before = log_density(made, chosen)
    for i in range(len(ITEMS)):
        if i not in chosen:
            assert float(beside[i]) == pytest.approx(log_density(made, [*chosen, i]) - before, abs=1e-8)


@pytest.mark.parametrize("prior_precision", [1e-5, 0.3, 1e3])
@pytest.mark.parametrize("chosen", [[], [0], [1, 3], [2, 4]])
def test_likelihood_of_any_noise_is_that_of_the_full_density_however_tight_the_priors(
    chosen, prior_precision
):
    made = dictionary(ITEMS, prior_precision=prior_precision)
    noise = torch.tensor([1.0, 0.3, 0.7, 1.6], dtype=torch.float64)
    likelihood = Products(made).log_likelihood(chosen, noise)
    expected = torch.tensor([log_density(made, chosen, float(one)) for one in noise], dtype=torch.float64)
    torch.testing.assert_close(likelihood - likelihood[0], expected - expected[0], rtol=1e-6, atol=1e-6)
    some = Products(made).among([*chosen, 5]).log_likelihood(range(len(chosen)), noise)
    torch.testing.assert_close(some, likelihood)


def test_likelihood_of_a_set_and_evidence_of_its_last_item_agree_where_the_numbers_are_free():
    products = Products(dictionary(ITEMS, prior_precision=1e-8))
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


def test_evidence_of_a_signal_is_that_of_readings_which_are_nothing_else():
    """With what two items change, one of them with a start, in the place of the residual."""
    made = dictionary(ITEMS)
    products, sizes = Products(made), torch.tensor([1.5, -2.0, 0.7], dtype=torch.float64)
    signal_T = made.columns[:, [1, 2, 8]] @ sizes + made.columns[:, 9]
    alone = Products(replace(made, residual=signal_T))
    signal = products.signal_of([1, 3], sizes)
    for chosen in ([], [3], [0, 4]):
        expected = alone.beside(chosen, 0.8)
        torch.testing.assert_close(
            Beside(products, chosen, 0.8, signal).evidence(), expected, rtol=1e-9, atol=1e-9
        )


@pytest.mark.parametrize("noise", [1.0, 0.6])
@pytest.mark.parametrize("shift", [None, 3])
@pytest.mark.parametrize("size", [1.0, -1.0, -60.0])  # the last one 40 standard deviations on the wrong side
def test_what_cannot_be_negative_has_the_evidence_of_a_half_normal_prior(size, shift, noise):
    """By the full density at each size, beside another item and after one with the same column that may be negative."""
    other, whole = item("other", [1, 2]), item("half", [0], width=2.0, shift=shift)
    half = replace(whole, is_one_sided=True)
    made = dictionary([other, whole, half], prior_precision=1e-5)
    made = replace(made, residual=made.residual + size * made.columns[:, 0])
    given = made.residual - (0.0 if shift is None else 1.0) * made.columns[:, 3]

    def log_density_at(value: float) -> float:
        return log_density(replace(made, residual=given - value * made.columns[:, 0]), [0], noise)

    sizes = torch.cat((torch.zeros(1), torch.logspace(-6.0, 1.15, 800))).double()
    log_prior = math.log(2.0 / (2.0 * math.sqrt(2.0 * math.pi))) - 0.125 * sizes.square()
    joint = torch.tensor([log_density_at(float(value)) for value in sizes], dtype=torch.float64) + log_prior
    largest = float(joint.max())
    integral = largest + math.log(float(torch.trapezoid((joint - largest).exp(), sizes)))
    expected = integral - log_density(made, [0], noise)
    beside = Products(made).beside([0], noise)
    assert float(beside[2]) == pytest.approx(expected, abs=1e-3)
    assert float(beside[1]) != pytest.approx(float(beside[2]), abs=0.1)


@pytest.mark.parametrize("chosen", [[0, 2], [0, 2, 3, 10], [1, 2, 3]])
def test_items_exchanged_for_others_leave_what_all_anew_leave(chosen):
    products = Products(dictionary(ITEMS))
    before = Beside(products, [0, 2, 3], 0.8)
    exchanged, anew = Beside(products, chosen, 0.8, before=before), Beside(products, chosen, 0.8)
    assert (exchanged.n_exchanges, anew.n_exchanges) == (1, 0)
    torch.testing.assert_close(exchanged.evidence(), anew.evidence(), rtol=1e-9, atol=1e-9)
    torch.testing.assert_close(exchanged.evidence(chosen[1]), anew.evidence(chosen[1]), rtol=1e-9, atol=1e-9)
