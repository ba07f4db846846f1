"""Halves of blocks of places and times."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from estimator.diagnosis.mixture.evidence import Products
from estimator.diagnosis.mixture.halves import blocks_of, expected_in_half, halves
from estimator.diagnosis.mixture.slots import NoisePrior, Slots
from tests.estimator.diagnosis.mixture.dictionaries import N_NUMBERS, N, dictionary, item

PRIOR_PRECISION = 0.3  # of the numbers of these dictionaries


def test_a_block_is_nearer_together_than_all_readings(small_session):
    readings = small_session.observations
    block = blocks_of(readings, small_session.rig, seed=1)
    (motion,) = readings.motion.values()
    place = motion[:, :3].numpy()

    def spread(rows: np.ndarray) -> float:
        return float(place[rows].var(axis=0).sum())

    inside = np.mean([spread(block == one) for one in np.unique(block)])
    assert inside < 0.5 * spread(np.ones(len(block), dtype=bool))


@pytest.mark.parametrize("size", [0.4, 0.9, 2.0])
def test_what_a_half_is_expected_to_say_is_the_mean_of_what_halves_with_other_noise_say(size):
    """One of two leading items, which the half shows hardly, in part, and clearly; over many draws of noise and of the rig's numbers."""
    items = [
        item("gain", [0]),
        item("gain", [0], width=20.0, log_prior=-3.0),
        item("beside", [1]),
        item("absent", [3]),
    ]
    made = dictionary(items)
    weight = (torch.arange(N) % 2 == 0).to(torch.float64)
    slots = Slots(Products(made, weight), NoisePrior(1.0, 0.0))
    sizes = torch.tensor([size, 6.0], dtype=torch.float64)
    expected = expected_in_half(slots, [0, 2], sizes, 0)
    signal = made.columns[:, [0, 1]] @ sizes
    generator = torch.Generator().manual_seed(3)
    probability = []
    for _ in range(400):
        numbers = torch.randn(N_NUMBERS, generator=generator, dtype=torch.float64) / PRIOR_PRECISION**0.5
        noise = torch.randn(N, generator=generator, dtype=torch.float64)
        drawn = dictionary(items, residual=signal + noise + made.always.jacobian @ numbers)
        of_slot = Slots(Products(drawn, weight), NoisePrior(1.0, 0.0)).conditional([2], 0)
        probability.append(of_slot[0] + of_slot[1])
    assert expected[0] == pytest.approx(np.mean(probability), abs=0.08)
    assert expected[2] > 0.9


def test_halves_are_complementary_and_keep_blocks_together(small_session):
    block = blocks_of(small_session.observations, small_session.rig, seed=1)
    made = list(halves(block, 3, seed=2))
    assert len(made) == 6
    for first, second in zip(made[::2], made[1::2], strict=True):
        assert (first ^ second).all()
        assert all(len(set(first[block == one])) == 1 for one in np.unique(block))
    assert len({tuple(one) for one in made}) == 6
