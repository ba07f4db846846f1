"""The rig's numbers as the mixture has them, against the full normal density of the models that were drawn."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
import torch
from torch import Tensor

from estimator.diagnosis.mixture.answer import Answer
from estimator.diagnosis.mixture.asked import Asked
from estimator.diagnosis.mixture.evidence import Products
from estimator.diagnosis.mixture.items import Dictionary
from estimator.diagnosis.mixture.numbers import Numbers
from estimator.diagnosis.mixture.slots import NoisePrior, Samples, Slots
from tests.estimator.diagnosis.mixture.dictionaries import N_NUMBERS, dictionary, item

ITEMS = [item("one", [0]), item("two", [1, 2]), item("moved", [3, 4], shift=5)]
NAMES = ("radius", "loops", "height")
PRIOR_MEAN = torch.tensor([0.3, -1.0, 2.0], dtype=torch.float64)


def answered(made: Dictionary, models: dict[tuple[int, ...], float], noise: float = 1.0) -> Answer:
    """An answer with these draws, at a factor on the noise."""
    samples = Samples(len(made.items), n=int(sum(models.values())))
    samples.models.update(models)
    samples.noises[0] = 1
    slots = Slots(Products(made), NoisePrior(1.0, 0.0))
    slots.grid = torch.tensor([noise], dtype=torch.float64)
    expansion = SimpleNamespace(names=NAMES, prior_mean=PRIOR_MEAN, always=made.always)
    asked = object.__new__(Asked)
    asked.__dict__.update(dictionary=made, samples=samples, slots=slots, expansion=expansion)
    return Answer(asked, asked, ())


def beside(made: Dictionary, model: tuple[int, ...], noise: float) -> tuple[Tensor, Tensor]:
    """Mean and covariance of the numbers beside some items: all unknowns together, by a dense regression."""
    items = [made.items[i] for i in model]
    columns = made.columns[:, [column for one in items for column in one.columns]]
    widths = torch.tensor([width for one in items for width in one.widths], dtype=torch.float64)
    readings = made.residual - sum((made.columns[:, one.shift] for one in items if one.shift), torch.zeros(1))
    design = torch.cat((made.always.jacobian, columns), dim=1)
    prior = torch.block_diag(made.prior_precision, (widths**-2).diag())
    covariance = torch.linalg.inv(design.T @ design / noise**2 + prior)
    mean = covariance @ design.T @ readings / noise**2
    return PRIOR_MEAN + mean[:N_NUMBERS], covariance[:N_NUMBERS, :N_NUMBERS]


@pytest.mark.parametrize("model", [(), (0,), (0, 2), (0, 1, 2)])
def test_numbers_beside_one_set_of_items_are_those_of_a_regression_of_all_together(model):
    made = dictionary(ITEMS)
    numbers = Numbers.of(answered(made, {model: 30}))
    mean, covariance = beside(made, model, 1.0)
    assert numbers.names == NAMES
    assert torch.allclose(numbers.mean, mean, atol=1e-8)
    assert torch.allclose(numbers.covariance, covariance, atol=1e-8)


@pytest.mark.parametrize("noise", [0.5, 1.4])
def test_another_noise_makes_them_surer_or_less_sure_where_the_readings_say_what_they_are(noise):
    made = dictionary(ITEMS, prior_precision=1e-6)
    numbers = Numbers.of(answered(made, {(0, 2): 30}, noise))
    mean, covariance = beside(made, (0, 2), noise)
    assert torch.allclose(numbers.mean, mean, atol=1e-4)
    assert torch.allclose(numbers.covariance, covariance, rtol=1e-4)


def test_several_sets_make_a_mixture_of_their_densities():
    """By the moments of draws from each, as many as it has of the draws."""
    made = dictionary(ITEMS)
    made = dictionary(ITEMS, residual=made.residual + 20.0 * made.columns[:, 0])
    models = {(): 20, (0, 1): 50, (2,): 30}
    numbers = Numbers.of(answered(made, models))
    each = [beside(made, model, 1.0) for model in models]
    weights = [n / 100.0 for n in models.values()]
    mean = sum(w * m for w, (m, _) in zip(weights, each, strict=True))
    square = sum(w * (c + torch.outer(m, m)) for w, (m, c) in zip(weights, each, strict=True))
    assert torch.allclose(numbers.mean, mean, atol=1e-8)
    assert torch.allclose(numbers.covariance, square - torch.outer(mean, mean), atol=1e-8)
    own = torch.stack([covariance.diagonal() for _, covariance in each]).amax(0)
    assert float((numbers.covariance.diagonal() / own).max()) > 1.2, "else the sets lie too near each other"


@pytest.mark.whole
def test_distance_from_a_fit_has_what_lies_between_them(of_nothing):
    numbers = Numbers.of(of_nothing)
    fit = of_nothing.plain
    assert numbers.names == tuple(p.name for p in fit.rig.free)
    apart = numbers.mean - fit.vector
    square = numbers.about(fit)
    assert torch.allclose(square.diagonal(), numbers.covariance.diagonal() + apart.square())
    assert (apart.abs() < 0.5 * fit.covariance.diagonal().sqrt()).all()
    ratio = (square.diagonal() / fit.covariance.diagonal()).sqrt()
    assert float(ratio.min()) > 0.99
    assert float(ratio.max()) < 2.0  # faint causes, which no clean session rules out, widen them


@pytest.mark.whole
def test_truth_lies_within_them_where_an_unknown_source_moves_the_plain_fit(of_dipole, small_session):
    numbers, fit = Numbers.of(of_dipole), of_dipole.plain
    assert small_session.truth is not None
    known = {name: torch.tensor(value, dtype=torch.float64) for name, value in small_session.truth.items()}
    truth = fit.posterior.coordinates.vector(known)
    by_mixture = (numbers.mean - truth).abs() / numbers.covariance.diagonal().sqrt()
    by_fit = (fit.vector - truth).abs() / fit.covariance.diagonal().sqrt()
    assert float(by_fit.max()) > 3.0
    assert float(by_mixture.max()) < 3.0
