"""The sampler against a sum over all states of its slots, and what is made of draws."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest

from estimator.diagnosis import policy
from estimator.diagnosis.mixture.evidence import Products
from estimator.diagnosis.mixture.items import Dictionary
from estimator.diagnosis.mixture.slots import NoisePrior, Slots, Sweeps
from tests.estimator.diagnosis.mixture.dictionaries import dictionary, item, log_density

KNOWN = NoisePrior(1.0, 0.0)
MANY = Sweeps(4000, 100)


def noisy() -> Dictionary:
    """Two items that resemble each other, a wider form of one, one that is not there, and a departure."""
    items = [
        item("gain", [0]),
        item("gain", [0], width=20.0, log_prior=-3.0),
        item("twin", [0, 1], log_prior=-2.5),
        item("absent", [3]),
        item("wanders", [4, 5], is_listed=False, log_prior=-2.2),
    ]
    made = dictionary(items)
    return dictionary(items, residual=made.residual + 1.2 * made.columns[:, 0] + 2.0 * made.columns[:, 4])


def exact(made: Dictionary, n_slots: int) -> np.ndarray:
    """Probability of each item by a sum over all states."""
    names = [one.name for one in made.items]
    n, weights = len(made.items), {}
    for state in product(range(n + 1), repeat=n_slots):
        chosen = tuple(sorted(i for i in state if i < n))
        there = {names[i] for i in chosen}
        if len(there) < len(chosen) or {made.items[i].repeated for i in chosen} - there - {""}:
            continue
        prior = sum(math.log(policy.p_empty()) if i == n else made.items[i].log_prior for i in state)
        weights[state] = prior + log_density(made, chosen)
    total = np.logaddexp.reduce(list(weights.values()))
    present = np.zeros(n)
    for state, weight in weights.items():
        for i in set(state) - {n}:
            present[i] += math.exp(weight - total)
    return present


def test_draws_have_the_probabilities_of_a_sum_over_all_states():
    made = noisy()
    samples = Slots(Products(made), KNOWN, n_slots=3).sample(MANY, seed=1)
    expected = exact(made, 3)
    assert expected[[0, 4]].min() > 0.2, "else the case says little"
    assert samples.present == pytest.approx(expected, abs=0.02)


def test_items_that_a_climb_found_negligible_are_left_out_and_the_others_are_as_probable_as_among_all():
    made = dictionary(
        [item("clear", [0], width=20.0), *(item(f"faint{i}", [3], width=1e-6) for i in range(3))]
    )
    slots = Slots(Products(made), KNOWN, n_slots=2)
    among_all = slots.drawn(MANY, 3, [None, None], noise=0).present
    assert slots.sample(MANY, 3).present == pytest.approx(among_all, abs=0.02)
    few = Products(made).among([2, 0])
    assert few.beside([1], 1.0)[0] == pytest.approx(float(Products(made).beside([0], 1.0)[2]), rel=1e-9)


def test_the_noise_is_found_where_it_is_free():
    made = dictionary([item("absent", [3])])
    quiet = dictionary(made.items, residual=0.5 * made.residual)
    slots = Slots(Products(quiet), NoisePrior(1.0, 1.0))
    samples = slots.sample(Sweeps(200, 10), seed=5)
    mean = sum(float(slots.grid[k]) * n for k, n in samples.noises.items()) / sum(samples.noises.values())
    assert mean == pytest.approx(0.5 * float(made.residual.std()), rel=0.15)


@pytest.mark.parametrize(("factor", "least", "most"), [(1.0, 1.0, 1.0), (2.0, 1.6, 2.4)])
def test_a_noise_that_is_stated_as_known_is_believed_unless_the_readings_refute_it(factor, least, most):
    made = dictionary([item("absent", [3])])
    readings = dictionary(made.items, residual=factor / float(made.residual.std()) * made.residual)
    slots = Slots(Products(readings), NoisePrior(1.0, 0.0, p_misstated=0.05))
    samples = slots.sample(Sweeps(200, 10), seed=5)
    assert least <= float(slots.grid[max(samples.noises, key=samples.noises.__getitem__)]) <= most


def test_excluded_items_are_in_no_draw_and_others_are_as_if_there_were_none():
    made = noisy()
    slots = Slots(Products(made), KNOWN, n_slots=3, excluded=[0, 1])
    samples = slots.sample(MANY, seed=6)
    assert not [model for model in samples.models if {0, 1} & set(model)]
    assert samples.present[[0, 1]].tolist() == [0.0, 0.0]
    assert samples.present[2:] == pytest.approx(exact(made.restricted([2, 3, 4]), 3), abs=0.02)


def test_the_same_seed_gives_the_same_draws():
    first, second = (Slots(Products(noisy()), KNOWN).sample(Sweeps(30, 5), seed=3) for _ in range(2))
    assert first.models == second.models
    assert first.present.tolist() == second.present.tolist()


def test_items_of_one_name_never_stand_beside_each_other():
    samples = Slots(Products(noisy()), KNOWN, n_slots=4).sample(Sweeps(300, 10), seed=4)
    assert not [model for model in samples.models if {0, 1} <= set(model)]


def test_a_second_piece_of_iron_stands_beside_a_first_alone():
    """Also where it alone would explain more."""
    items = [item("iron_body", [0]), item("second_iron_body", [1]), item("gain", [3])]
    made = dictionary(items)
    made = dictionary(items, residual=made.residual + 0.8 * made.columns[:, 0] + 2.0 * made.columns[:, 1])
    samples = Slots(Products(made), KNOWN, n_slots=3).sample(MANY, seed=1)
    expected = exact(made, 3)
    assert 0.1 < expected[1] < expected[0] < 0.9, "else the case says little"
    assert samples.present == pytest.approx(expected, abs=0.02)
    assert not [model for model in samples.models if 1 in model and 0 not in model]


def test_the_highest_of_several_climbs_counts():
    """One that begins with nothing takes no first piece, so that it never sees the second."""
    items = [item("iron_body", [0]), item("second_iron_body", [1])]
    made = dictionary(items)
    made = dictionary(items, residual=made.residual + 6.0 * made.columns[:, 1])
    slots = Slots(Products(made), KNOWN, n_slots=3)
    assert max(slots.sample(Sweeps(1, 0), 1).models) == ()
    assert max(slots.sample(Sweeps(1, 0), 1, (), (0, 1)).models) == (0, 1)
