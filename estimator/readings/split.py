"""Which readings are kept out of the fit, to judge it."""

from __future__ import annotations

import warnings

import numpy as np
import torch
from jaxtyping import Bool, Int
from scipy.cluster.vq import kmeans2
from torch import Tensor

from estimator.errors import InvalidInput
from estimator.readings.observations import Observations

FEWEST_BLOCKS, MOST_BLOCKS = 20, 200
PLACES_OF_BLOCK = 50  # where there are enough of them for more than the fewest blocks


def block_split(observations: Observations, share: float, seed: int) -> Bool[Tensor, " reading"]:
    """Mark whole blocks of neighbouring places as validation, drawn with a seed.

    Readings next to each other share whatever the model gets wrong, so single readings taken out at random would flatter it. Blocks are
    drawn until they hold the share.

    Args:
        observations: The readings.
        share: Wanted share of the readings, 0 <= share < 1.
        seed: Decides blocks and draw.
    Returns: True where a reading is kept out.
    """
    if not 0.0 <= share < 1.0:
        raise InvalidInput(f"validation share must be at least 0 and below 1; received {share:g}")
    n = len(observations)
    if share == 0.0 or n < 2:
        return torch.zeros(n, dtype=torch.bool)
    rng = np.random.default_rng(seed)
    block = blocks_of_places(observations, rng)
    is_validation = np.zeros(n, dtype=bool)
    for chosen in rng.permutation(np.unique(block)):
        if is_validation.sum() >= share * n:
            break
        is_validation |= block == chosen
    return torch.from_numpy(is_validation)


def blocks_of_places(observations: Observations, rng: np.random.Generator) -> Int[np.ndarray, " reading"]:
    """Number of the block of every reading: places (sensor and pose together) in 20 groups by k-means, up to 200 where there are many."""
    features = [observations.sensor[:, None].double(), *(motion for motion in observations.motion.values())]
    places = torch.cat(features, dim=1).numpy()
    spread = places.std(axis=0)
    distinct, place = np.unique(
        (places - places.mean(axis=0)) / np.where(spread > 0.0, spread, 1.0), axis=0, return_inverse=True
    )
    n_blocks = min(max(len(distinct) // PLACES_OF_BLOCK, FEWEST_BLOCKS), MOST_BLOCKS, len(distinct))
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "One of the clusters is empty", UserWarning)  # one block less
        _, block_of_place = kmeans2(distinct, n_blocks, minit="++", rng=rng)
    found: Int[np.ndarray, " reading"] = block_of_place[place]
    return found


def thinned(observations: Observations, most: int, seed: int) -> Observations:
    """At most so many of the readings, drawn at random."""
    if len(observations) <= most:
        return observations
    generator = torch.Generator().manual_seed(seed)
    return observations.rows(torch.randperm(len(observations), generator=generator)[:most].sort().values)
