"""The validation split: whole blocks of neighbouring poses, a share that is kept, a seed that decides."""

from __future__ import annotations

import time

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from estimator.errors import InvalidInput
from estimator.readings import split
from estimator.readings.observations import Observations
from estimator.readings.split import block_split, time_blocks


def readings(position_m: np.ndarray, sensor: np.ndarray | None = None) -> Observations:
    n = len(position_m)
    pose = np.concatenate([position_m, np.zeros((n, 6 - position_m.shape[1]))], axis=1)
    more = {} if sensor is None else {"sensor": torch.from_numpy(sensor)}
    motion = {"stage": torch.from_numpy(pose)}
    return Observations.of(torch.ones(n, 1).double(), motion, torch.zeros(n, 3).double(), **more)


def grid(n: int, size_m: float = 0.1) -> np.ndarray:
    stops = np.linspace(0.0, size_m, n)
    return np.stack(np.meshgrid(stops, stops, stops, indexing="ij"), axis=-1).reshape(-1, 3)


@pytest.mark.parametrize("share", [0.1, 0.2, 0.5, 0.8])
def test_the_share_is_kept_to_within_a_block(share):
    for seed in range(10):
        kept_out_share = block_split(readings(grid(7)), share, seed).double().mean().item()
        assert share <= kept_out_share < share + 0.12  # blocks hold about a twentieth, the largest twice that


def test_a_share_of_zero_keeps_every_reading():
    assert not block_split(readings(grid(3)), 0.0, 0).any()


@pytest.mark.parametrize("share", [-0.1, 1.0, 20.0, float("nan")])
def test_a_share_outside_its_range_is_refused(share):
    with pytest.raises(InvalidInput, match=r"validation share must be at least 0 and below 1; received"):
        block_split(readings(grid(3)), share, 0)


def test_neighbours_are_kept_out_together():
    """A reading kept out has far more neighbours kept out with it than single readings drawn at random would have."""
    position_m = grid(8)
    distance_m = np.linalg.norm(position_m[:, None] - position_m[None], axis=-1)
    is_neighbour = (distance_m > 0.0) & (distance_m < 0.1 / 7 * 1.01)
    together = []
    for seed in range(10):
        kept_out = block_split(readings(position_m), 0.2, seed).numpy()
        together.append((is_neighbour & kept_out)[kept_out].sum() / is_neighbour[kept_out].sum())
    assert min(together) > 0.5  # 0.2 where readings are drawn one by one


def test_blocks_are_neighbours_in_units_of_their_own_spread():
    """Rotations in radians count like positions in metres: each axis is measured by how far it was moved."""
    scaled = grid(6) * np.array([2.0**-10, 1.0, 2.0**6])  # powers of two, so that rounding is the same
    assert torch.equal(block_split(readings(scaled), 0.2, 0), block_split(readings(grid(6)), 0.2, 0))


def test_blocks_of_time_hold_readings_that_follow_each_other():
    observations = readings(grid(5))
    backwards = observations.rows(torch.arange(len(observations)).flip(0))
    block = time_blocks(observations)
    assert (np.diff(block) >= 0).all()
    assert np.ptp(np.bincount(block, minlength=20)) <= 1
    assert (time_blocks(backwards) == block[::-1]).all()


@given(
    n_positions=st.integers(1, 40),
    n_repeats=st.integers(1, 4),
    n_sensors=st.integers(1, 3),
    share=st.floats(0.0, 0.95),
    seed=st.integers(0, 2**32 - 1),
)
def test_repeats_of_one_pose_never_straddle(
    n_positions: int, n_repeats: int, n_sensors: int, share: float, seed: int
) -> None:
    positions = np.random.default_rng(seed).integers(0, 4, size=(n_positions, 3)) * 0.01
    position_m = np.tile(np.repeat(positions, n_sensors, axis=0), (n_repeats, 1))
    sensor = np.tile(np.arange(n_sensors), n_positions * n_repeats)
    kept_out = block_split(readings(position_m, sensor), share, seed).numpy()
    decided: dict[tuple, bool] = {}
    for key, is_out in zip(map(tuple, np.column_stack([sensor, position_m])), kept_out, strict=True):
        assert decided.setdefault(key, is_out) == is_out


def test_a_million_poses_are_split_in_seconds():
    """Blocks are placed by some of the poses, and hold the share all the same."""
    position_m = np.random.default_rng(0).uniform(-0.1, 0.1, (200_000, 3))
    begin_s = time.process_time()
    share = block_split(readings(position_m), 0.2, 0).double().mean().item()
    assert time.process_time() - begin_s < 10.0
    assert 0.2 <= share < 0.22


def test_blocks_are_of_neighbours_where_only_some_poses_place_them(monkeypatch):
    monkeypatch.setattr(split, "MOST_POSES", 200)
    whole = readings(grid(12))
    block = split.pose_blocks(whole, np.random.default_rng(0))
    position_m = whole.motion["stage"][:, :3].numpy()
    centres = np.array([position_m[block == number].mean(axis=0) for number in np.unique(block)])
    own_m = np.linalg.norm(position_m - centres[np.unique(block, return_inverse=True)[1]], axis=1)
    nearest_m = np.linalg.norm(position_m[:, None] - centres, axis=2).min(axis=1)
    assert np.quantile(own_m - nearest_m, 0.9) < 0.02
    assert len(np.unique(block)) > 15


def test_the_seed_decides() -> None:
    observations = readings(grid(5))
    assert torch.equal(block_split(observations, 0.2, 3), block_split(observations, 0.2, 3))
    assert not torch.equal(block_split(observations, 0.2, 3), block_split(observations, 0.2, 4))
