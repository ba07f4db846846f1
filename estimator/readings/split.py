"""Select the readings that are kept out of a fit to validate it."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from estimator.devices import numpy_of
from estimator.errors import InvalidInput
from estimator.readings.clusters import k_means
from estimator.readings.observations import Observations
from estimator.tensors import Tensor, torch

FEWEST_BLOCKS, MOST_BLOCKS = 20, 200
MOST_POSES = 10_000  # that k-means sees
POSES_PER_BLOCK = 50  # if that gives more than the fewest blocks


def block_split(observations: Observations, share: float, seed: int) -> Bool[Tensor, " reading"]:
    """Mark whole blocks of neighbouring poses as validation, drawn at random.

    Neighbouring readings share the errors of the model, so single readings kept out at random would make it look too good. Blocks are drawn
    until they hold the share.

    Args:
        observations: The readings.
        share: Share of the readings to keep out, 0 <= share < 1.
        seed: Seed of blocks and draw.
    Returns: True for readings that are kept out.
    """
    if not 0.0 <= share < 1.0:
        raise InvalidInput(f"validation share must be at least 0 and below 1; received {share:g}")
    n = len(observations)
    if share == 0.0 or n < 2:
        return torch.zeros(n, dtype=torch.bool)
    rng = np.random.default_rng(seed)
    block = pose_blocks(observations, rng)
    is_validation = np.zeros(n, dtype=bool)
    for number in rng.permutation(np.unique(block)):
        if is_validation.sum() >= share * n:
            break
        is_validation |= block == number
    return torch.from_numpy(is_validation)


def pose_blocks(observations: Observations, rng: np.random.Generator) -> Int[np.ndarray, " reading"]:
    """Block number of every reading: k-means of the distinct poses of each sensor, with 20 blocks, or up to 200 for many poses."""
    distinct, pose_row = _distinct(_features(observations))
    n_blocks = min(max(len(distinct) // POSES_PER_BLOCK, FEWEST_BLOCKS), MOST_BLOCKS, len(distinct))
    few = distinct
    if len(distinct) > MOST_POSES:  # these place the blocks as well as a million, in seconds
        few = distinct[np.sort(rng.choice(len(distinct), MOST_POSES, replace=False))]
    centres, block_of_pose = k_means(few, n_blocks, rng)
    if len(few) < len(distinct):
        from scipy.spatial import cKDTree  # takes a quarter of a second to load

        block_of_pose = np.asarray(cKDTree(centres).query(distinct)[1])
    return block_of_pose[pose_row]


def _features(observations: Observations) -> Float[np.ndarray, "reading column"]:
    """Columns that distinguish poses, each with mean 0 and standard deviation 1."""
    columns = [observations.sensor[:, None].double(), *observations.motion.values()]
    features = [
        (each - each.mean()) / each.std()
        for part in columns
        for each in numpy_of(part).T
        if np.ptp(each) > 0.0
    ]
    return np.stack(features or [np.zeros(len(observations))], axis=1)


def _distinct(
    poses: Float[np.ndarray, "reading column"],
) -> tuple[Float[np.ndarray, "pose column"], Int[np.ndarray, " reading"]]:
    """Distinct poses in lexical order, and the row of each reading among them; `np.unique` does the same in five times the time."""
    order = np.lexsort(poses.T[::-1])
    is_new = np.zeros(len(order), dtype=bool)
    is_new[:1] = True
    for column in poses.T:  # one by one, for there may be millions of poses
        ordered = column[order]
        is_new[1:] |= ordered[1:] != ordered[:-1]
    row = np.empty_like(order)
    row[order] = np.cumsum(is_new) - 1
    return poses[order[is_new]], row


def with_validation(observations: Observations, share: float, seed: int) -> Observations:
    """The readings with a share of them marked for validation, as `block_split` does, unless some are marked already."""
    if bool(observations.is_validation.any()):
        return observations
    return observations.with_validation(block_split(observations, share, seed))


def time_blocks(observations: Observations) -> Int[np.ndarray, " reading"]:
    """Block number of every reading, in blocks of readings that were taken one after another."""
    order = numpy_of(observations.time_s.argsort(stable=True).argsort())
    return order * FEWEST_BLOCKS // len(order)


def spread(observations: Observations, most: int) -> Observations:
    """At most `most` of the readings, spread evenly over them."""
    n = len(observations)
    rows = torch.linspace(0, n - 1, min(most, n), device=observations.device).round().long()
    return observations.rows(rows.unique())


def thinned(observations: Observations, most: int, seed: int) -> Observations:
    """At most `most` of the readings, drawn at random, in their order."""
    if len(observations) <= most:
        return observations
    generator = torch.Generator().manual_seed(seed)
    return observations.rows(torch.randperm(len(observations), generator=generator)[:most].sort().values)


def some_distinct(
    key: Float[Tensor, "row column"], most: int, generator: torch.Generator
) -> Int[Tensor, " distinct"]:
    """The first row of each distinct key, at most so many, in random order."""
    distinct, which = torch.unique(key, dim=0, return_inverse=True)
    rows = torch.arange(len(key))
    first = torch.full((len(distinct),), len(key)).scatter_reduce(0, which, rows, "amin")
    return first[torch.randperm(len(first), generator=generator)[:most]]
