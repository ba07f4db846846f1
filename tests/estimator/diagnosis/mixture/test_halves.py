"""Halves of blocks of places and times."""

from __future__ import annotations

import numpy as np
import torch

from estimator.diagnosis.mixture.halves import blocks_of, halves, weight_of


def test_halves_are_complementary_and_keep_blocks_together(small_session):
    block = blocks_of(small_session.observations, small_session.rig, seed=1)
    made = list(halves(block, 3, seed=2))
    assert len(made) == 6
    for first, second in zip(made[::2], made[1::2], strict=True):
        assert (first ^ second).all()
        assert all(len(set(first[block == one])) == 1 for one in np.unique(block))
    assert len({tuple(one) for one in made}) == 6


def test_a_block_is_nearer_together_than_all_readings(small_session):
    readings = small_session.observations
    block = blocks_of(readings, small_session.rig, seed=1)
    (motion,) = readings.motion.values()
    place = motion[:, :3].numpy()

    def spread(rows: np.ndarray) -> float:
        return float(place[rows].var(axis=0).sum())

    inside = np.mean([spread(block == one) for one in np.unique(block)])
    assert inside < 0.5 * spread(np.ones(len(block), dtype=bool))


def test_missing_components_have_no_weight():
    is_measured = torch.tensor([[True, False, True], [True, True, True]])
    assert weight_of(np.array([True, False]), is_measured).tolist() == [1.0, 1.0, 0.0, 0.0, 0.0]
