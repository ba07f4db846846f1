"""Whether what the readings say holds in halves of them: complementary halves of blocks of places and times.

Structure that no item describes makes slots fill with what resembles it in these readings; in other readings something else resembles it
(docs/explanation/how-a-cause-is-named.md).

References:
    Meinshausen and Buehlmann, J. R. Stat. Soc. B 72, 417 (2010); Shah and Samworth, ibid. 75, 55 (2013): complementary pairs.
    Huggins and Miller, Bayesian Analysis 18, 79 (2023): posteriors of misspecified models.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Sequence

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.cluster.vq import kmeans2
from torch import Tensor

from estimator.devices import numpy_of
from estimator.diagnosis import policy
from estimator.diagnosis.mixture.evidence import Beside
from estimator.diagnosis.mixture.slots import Slots
from estimator.geometry.motion import base_from_motion
from estimator.readings.observations import Observations
from estimator.rig.rig import Rig

N_BLOCKS, LEAST_IN_A_BLOCK = 30, 3
N_NODES = 15  # of the mean over the noise
LARGE = 500.0  # log odds beyond which nothing changes
WEIGHT_OF_TIME = 3.0  # of the whole session over a standard deviation of the positions


def blocks_of(observations: Observations, rig: Rig, seed: int) -> Int[np.ndarray, " reading"]:
    """Block of each reading: readings near each other in place and time are in one."""
    order, *places = order_and_places(observations, rig)
    n_blocks = max(2, min(N_BLOCKS, len(observations) // LEAST_IN_A_BLOCK))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # a block may stay empty where places repeat
        near = np.column_stack([WEIGHT_OF_TIME * order, *places])
        _, block = kmeans2(near, n_blocks, minit="++", seed=seed)
    return np.unique(block, return_inverse=True)[1]


def order_and_places(observations: Observations, rig: Rig) -> list[Float[np.ndarray, " reading"]]:
    """The order of the readings, from -0.5 to 0.5, and the coordinates of each mover that moves, in its spread."""
    order = np.argsort(np.argsort(numpy_of(observations.time_s), kind="stable"), kind="stable")
    coordinates = [order / len(observations) - 0.5]
    for mover in rig.movers:
        position_m = numpy_of(base_from_motion(mover, observations.motion[mover.name]).translation_m)
        spread_m = position_m.std()
        if spread_m > 0.0:
            coordinates += list(((position_m - position_m.mean(0)) / spread_m).T)
    return coordinates


def halves(block: Int[np.ndarray, " reading"], n_pairs: int, seed: int) -> Iterator[np.ndarray]:
    """Which readings each half has; halves come in complementary pairs of blocks.

    Examples:
        >>> first, second = halves(np.array([0, 0, 1, 1]), 1, seed=1)
        >>> bool((first ^ second).all())
        True
    """
    random = np.random.default_rng(seed)
    n_blocks = int(block.max()) + 1
    for _ in range(n_pairs):
        chosen = np.isin(block, random.permutation(n_blocks)[: n_blocks // 2])
        yield chosen
        yield ~chosen


def expected_in_half(slots: Slots, leading: Sequence[int], sizes: Tensor, noise: int) -> dict[int, float]:
    """Probability that each leading item is expected to have in a half of the readings, were all of them there.

    Args:
        slots: Of the half.
        leading: Numbers of the items.
        sizes: Coefficients of their columns in all readings, one item after the other.
        noise: Number of the factor on the noise.
    """
    products, signal = slots.products, slots.products.signal_of(leading, sizes)
    result = {}
    for item in leading:
        rest = [other for other in leading if other != item]
        evidence = Beside(products, rest, float(slots.grid[noise]), signal).evidence() + slots.log_prior
        is_own = slots.name == slots.name[item]
        is_open = ~np.isin(slots.name, slots.name[rest]) & ~is_own
        others = torch.cat((evidence[is_open], evidence.new_tensor([math.log(policy.p_empty())])))
        log_odds = float(torch.logsumexp(evidence[is_own], 0) - torch.logsumexp(others, 0))
        log_bayes_factor = float((evidence - slots.log_prior)[is_own].max())
        result[item] = mean_probability(log_odds, log_bayes_factor)
    return result


def mean_probability(log_odds: float, log_bayes_factor: float) -> float:
    """Mean over the noise of the probability of what is there; its log Bayes factor scatters by the root of twice its expected value.

    Args:
        log_odds: Expected.
        log_bayes_factor: Expected, a part of the log odds.
    Examples:
        >>> round(mean_probability(0.0, 8.0), 6)
        0.5
    """
    nodes, weights = np.polynomial.hermite_e.hermegauss(N_NODES)
    spread = math.sqrt(2.0 * max(log_bayes_factor, 0.0))
    probability = 1.0 / (1.0 + np.exp(-np.clip(log_odds + spread * nodes, -LARGE, LARGE)))
    return float((weights * probability).sum() / weights.sum())


def weight_of(is_in: np.ndarray, is_measured: Tensor) -> Float[Tensor, " component"]:
    """1 for the measured components of readings of a half, 0 for others."""
    by_reading = torch.from_numpy(is_in.astype(float))[:, None].expand(-1, 3)
    return by_reading[is_measured.cpu()]
