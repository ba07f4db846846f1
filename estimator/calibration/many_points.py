"""Credible intervals at many points, whose fields of all posterior draws are combinations of the fields of a few draws.

A posterior is narrow, so that the fields of its draws differ in a dozen ways. Which draws show these, and how the others follow from them,
is found at some of the points and checked at others.

References: Cheng, Gimbutas, Martinsson, Rokhlin, SIAM J. Sci. Comput. 26, 1389 (2005): the interpolative decomposition.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from estimator.tensors import Tensor

MANY = 2000  # points from which on this pays
N_TRIED, N_CHECKED = 200, 100  # points at which the fields of all draws are computed
WITHIN = 1e-4  # of all differences at the points that are tried, in their norm
MOST_OFF = 0.01  # of a standard deviation of the draws, at any point that is checked
POINTS_AT_ONCE = 4000

Values = Float[np.ndarray, "draw point *axis"]
Draws = Mapping[str, Tensor]


def tails(level: float) -> list[float]:
    """Probabilities below the ends of a central interval."""
    return [0.5 - 0.5 * level, 0.5 + 0.5 * level]


def ends_at_many(
    of_draws: Callable[[Int[np.ndarray, " some"], Draws], Values],
    draws: Draws,
    is_near: Bool[np.ndarray, " point"],
    level: float,
) -> Float[np.ndarray, "2 point *axis"] | None:
    """Ends of the central interval at many points: by combinations of a few draws, and by all of them near windings.

    Args:
        of_draws: Values of some draws at some points, by number.
        draws: Of the numbers of the rig, along one batch axis; those that are fixed have none.
        is_near: Points near a winding, where fields bend over the width of a posterior.
        level: Probability inside.
    Returns: None where there are few points, or where no few draws stand for all.
    """
    near, far = np.flatnonzero(is_near), np.flatnonzero(~is_near)
    if len(far) < MANY or not any(value.dim() for value in draws.values()):
        return None
    some = np.random.default_rng(0).choice(far, N_TRIED + N_CHECKED, replace=False)
    few = Combinations.of(of_draws(some, draws))
    if few is None:
        return None
    chosen = {name: value[few.chosen] if value.dim() else value for name, value in draws.items()}
    at_far = few.ends(of_draws(far, chosen), level)
    result = np.empty((2, len(is_near), *at_far.shape[2:]))
    result[:, far] = at_far
    if len(near):
        result[:, near] = np.quantile(of_draws(near, draws), tails(level), axis=0)
    return result


class Combinations(NamedTuple):
    """How the values of all draws follow from those of a few.

    Attributes:
        chosen: Numbers of these draws; the first is that from which all others are counted.
        weights: Of their differences from the first one, in those of all other draws.
    """

    chosen: Int[np.ndarray, " few"]
    weights: Float[np.ndarray, "different draw"]

    @classmethod
    def of(cls, values: Values) -> Combinations | None:
        """Combinations that hold at some points.

        Args:
            values: Of all draws at `N_TRIED + N_CHECKED` points, which may be NaN.
        Returns: None where they do not hold at those that are checked.
        """
        from scipy.linalg.interpolative import interp_decomp, reconstruct_interp_matrix

        by_draw = values.reshape(*values.shape[:2], -1)
        is_free = np.isfinite(by_draw).all(axis=(0, 2))
        is_tried = np.arange(len(is_free)) % (N_TRIED + N_CHECKED) < N_TRIED
        tried, checked = (
            by_draw[:, is_free & some].reshape(len(values), -1).T for some in (is_tried, ~is_tried)
        )
        differences, spread = tried[:, 1:] - tried[:, :1], tried.std(axis=1)
        if not (checked.size and (spread > 0.0).any()):
            return None
        differences, spread = differences[spread > 0.0], spread[spread > 0.0]
        few, order, coefficients = interp_decomp(differences / spread[:, None], WITHIN, rand=False)
        result = cls(np.r_[0, order[:few] + 1], reconstruct_interp_matrix(order, coefficients))
        off = np.abs(result.differences(checked[:, result.chosen]) - (checked - checked[:, :1]))
        return result if (off.max(axis=1) <= MOST_OFF * checked.std(axis=1)).all() else None

    def differences(self, of_few: Float[np.ndarray, "number few"]) -> Float[np.ndarray, "number draw"]:
        """Differences of all draws from the first one, in single precision, from the values of the chosen draws."""
        from_first = (of_few - of_few[:, :1]).astype(np.float32)
        others = from_first[:, 1:] @ self.weights.astype(np.float32)
        return np.concatenate((from_first[:, :1], others), axis=1)

    def ends(self, of_few: Values, level: float) -> Float[np.ndarray, "2 point *axis"]:
        """Ends of the central interval at each point, over all draws.

        Args:
            of_few: Values of the chosen draws.
            level: Probability inside.
        """
        _, n_points, *axes = of_few.shape
        result = np.empty((2, n_points, *axes))
        for first in range(0, n_points, POINTS_AT_ONCE):
            some = of_few[:, first : first + POINTS_AT_ONCE].reshape(len(of_few), -1)
            ordered = np.sort(self.differences(np.ascontiguousarray(some.T)), axis=1)
            at = np.array(tails(level)) * (ordered.shape[1] - 1)
            below, share = at.astype(int), at % 1.0
            above = np.minimum(below + 1, ordered.shape[1] - 1)
            ends = some[0] + (ordered[:, below] * (1.0 - share) + ordered[:, above] * share).T
            result[:, first : first + POINTS_AT_ONCE] = ends.reshape(2, -1, *axes)
        return result
