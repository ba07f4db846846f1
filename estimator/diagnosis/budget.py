"""The error budget: how much of what the rig as described misses each cause accounts for, on readings that no fit has seen.

What a cause accounts for depends on what stands beside it. So causes are added one after another, in all orders where they are few and in
one order and its reverse where they are many, each time with all numbers fitted anew. The share of a cause is the mean of what it
takes away (Shapley, Contributions to the Theory of Games 2, 307 (1953)), so shares add up to the whole. What depends on the order is
shared. Some causes that, without the others, predict worse than the rig as described count for nothing together.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Any

import numpy as np
import torch
from jaxtyping import Float

from estimator.diagnosis import effort, policy
from estimator.diagnosis.expectation import predict_T
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.effects.use import as_meant
from estimator.inference.likelihood import LogPosterior
from estimator.readings.observations import Observations
from estimator.rig.rig import EVERYWHERE, Cause, Rig
from estimator.side_by_side import each

# Squared error beyond the noise, over that of the noise, from which on an error budget is told
LEAST_MISFIT_TOLD = 0.1

MOST_IN_ALL_ORDERS = 3  # causes; of more in one order and its reverse
# Fits with some of the causes stop at this share of the rise in log density that all of them bring
SHARE_OF_WHOLE = 1e-3
N_RESAMPLED = 400  # sets of readings drawn with replacement, for the intervals
Squares = Float[np.ndarray, " reading"]


@dataclass(frozen=True)
class Share:
    """Part of the squared error of the rig as described, beyond the noise.

    Attributes:
        value: Of 1.
        ci90: 90 % interval over the choice of the readings; where not all orders were tried, as wide as the orders differ.
    """

    value: float
    ci90: tuple[float, float]

    def to_json(self) -> dict[str, Any]:
        """This share in the form of `diagnosis.json`."""
        return {"share": self.value, "ci90": list(self.ci90)}


@dataclass(frozen=True)
class Budget:
    """Shares of the squared error on readings that no fit has seen.

    Attributes:
        n_readings: Their number.
        misfit_T: What the rig as described misses beyond the noise, root mean square of the vector.
        noise_T: Noise of the vector.
        causes: Share of each cause of the extended rig, and of each kind of correction at all its places.
        shared: What several of them account for alike.
        left: What none of them accounts for.
        has_all_orders: Whether causes were added in all orders, so that the shares are exact.
    """

    n_readings: int
    misfit_T: float
    noise_T: float
    causes: Mapping[Cause, Share]
    shared: Share
    left: Share
    has_all_orders: bool = True

    def is_negligible(self, cause: Cause) -> bool:
        """Whether the interval of a cause's share ends below `policy.NEGLIGIBLE_SHARE` of a misfit above the noise; not where it has none.

        What is hidden in the noise of few unseen readings is the share of any weak cause, right or wrong.
        """
        is_known = cause in self.causes and self.misfit_T > self.noise_T
        return is_known and self.causes[cause].ci90[1] < policy.NEGLIGIBLE_SHARE

    def to_json(self) -> dict[str, Any]:
        """Content of `budget` in `diagnosis.json`."""
        return {
            "readings": self.n_readings,
            "misfit_T": self.misfit_T,
            "noise_T": self.noise_T,
            "causes": [{"name": c.name, "place": c.place, **s.to_json()} for c, s in self.causes.items()],
            "shared": self.shared.to_json(),
            "left": self.left.to_json(),
        }


def budget(plain: Fit, extended: Fit, unseen: Observations, seed: int) -> Budget | None:
    """The error budget; None where the rig as described misses these readings by no more than the noise leaves.

    Args:
        plain: Fit of the rig as described.
        extended: With causes and corrections, fitted to the same readings.
        unseen: Readings that neither has seen.
        seed: Of the choice of readings for the intervals.
    """
    groups = _groups(plain, extended)
    causes = list(groups)
    if not causes or not len(unseen):
        return None
    nothing, everything = frozenset[Cause](), frozenset(causes)
    squares = {nothing: _squares(plain, unseen), everything: _squares(extended, unseen)}
    orders = _orders(len(causes), seed)
    sets = {frozenset(causes[i] for i in order[:n]) for order in orders for n in range(1, len(causes))}

    def squares_with(some: frozenset[Cause]) -> Squares:
        acting = [cause for group in some for cause in groups[group]]
        with_some = _squares(_fit_with(plain, extended, acting), unseen)
        return min(with_some, squares[nothing], key=np.mean)

    squares |= dict(zip(sets, each(squares_with, sets), strict=True))
    noise = _noise(extended, unseen)
    misfit = float((squares[nothing] - noise).mean())
    if misfit <= LEAST_MISFIT_TOLD * float(noise.mean()):
        return None
    random = np.random.default_rng(seed)
    n = len(noise)
    chosen = [np.arange(n), *(random.integers(n, size=n) for _ in range(N_RESAMPLED))]
    rows = np.array([_shares(squares, noise, causes, orders, rows) for rows in chosen])
    value, has_all_orders = rows[0].mean(0), len(causes) <= MOST_IN_ALL_ORDERS
    least, most = (rows.mean(1),) * 2 if has_all_orders else (rows.min(1), rows.max(1))
    low, high = np.quantile(least[1:], 0.05, axis=0), np.quantile(most[1:], 0.95, axis=0)
    shares = [Share(float(v), (float(a), float(b))) for v, a, b in zip(value, low, high, strict=True)]
    return Budget(
        n,
        misfit**0.5,
        float(noise.mean()) ** 0.5,
        dict(zip(causes, shares[:-2], strict=True)),
        shares[-2],
        shares[-1],
        has_all_orders,
    )


def _groups(plain: Fit, extended: Fit) -> dict[Cause, list[Cause]]:
    """What has a share of its own: each cause, and each kind of correction at all its places."""
    groups: dict[Cause, list[Cause]] = {}
    for cause in extended.rig.acting:
        if cause in plain.rig.acting:
            continue
        is_correction = cause in extended.rig.corrections
        group = next((group for group in groups if is_correction and group.name == cause.name), cause)
        groups.setdefault(group, []).append(cause)
    return {
        Cause(group.name, EVERYWHERE) if len(causes) > 1 else group: causes
        for group, causes in groups.items()
    }


def _orders(n: int, seed: int) -> list[tuple[int, ...]]:
    """Orders in which so many causes are added: all, or one and its reverse."""
    if n <= MOST_IN_ALL_ORDERS:
        return list(permutations(range(n)))
    order = tuple(np.random.default_rng(seed).permutation(n).tolist())
    return [order, order[::-1]]


def _shares(
    squares: Mapping[frozenset[Cause], Squares],
    noise: Squares,
    causes: Sequence[Cause],
    orders: Sequence[Sequence[int]],
    rows: np.ndarray,
) -> Float[np.ndarray, "order share"]:
    """What each cause takes away in each order, what they share, and what is left, of some readings."""
    mean = {some: float(each[rows].mean()) for some, each in squares.items()}
    before, after = mean[frozenset()], mean[frozenset(causes)]
    misfit = max(before - float(noise[rows].mean()), 1e-300)
    taken = np.zeros((len(orders), len(causes)))
    for row, order in zip(taken, orders, strict=True):
        present = frozenset[Cause]()
        for i in order:
            row[i] = (mean[present] - mean[present | {causes[i]}]) / misfit
            present |= {causes[i]}
    whole = (before - after) / misfit
    rest = np.tile([whole - float(taken.min(0).sum()), 1.0 - whole], (len(orders), 1))
    return np.hstack((taken, rest))


def _fit_with(plain: Fit, extended: Fit, causes: Collection[Cause]) -> Fit:
    """The rig as described with some of the causes of the extended one, fitted to the same readings."""
    rig: Rig = extended.rig
    for cause in extended.rig.acting:
        if cause not in plain.rig.acting and cause not in causes:
            rig = rig.without_cause(cause)
    whole = float(extended.optimum.log_posterior - plain.optimum.log_posterior)
    return fit_rig(
        rig,
        extended.observations,
        extended.values,
        extended.posterior.model.rules,
        tolerance=max(SHARE_OF_WHOLE * whole, effort.ROUGH_TOLERANCE),
        near=extended,
        ends_exact=False,
    )


def _squares(fit: Fit, unseen: Observations) -> Squares:
    """Squared length of the error vector of each reading, in T^2."""
    missed_T = as_meant(fit.rig, unseen).field_sensor_T - predict_T(fit, fit.values, unseen)
    return missed_T.nan_to_num().square().sum(-1).numpy()


def _noise(fit: Fit, unseen: Observations) -> Squares:
    """Squared length of the error vector that the noise leaves, as it is recorded, in T^2."""
    meant = as_meant(fit.rig, unseen)
    posterior = LogPosterior(fit.posterior.coordinates, fit.model_of(meant), meant)
    with torch.no_grad():
        share, ratio = posterior.contamination(fit.values)
        squares = posterior.component_sigma_T(fit.vector).square() * (1.0 + share * (ratio.square() - 1.0))
    by_component = squares.new_zeros(len(meant), 3)
    by_component[meant.is_measured] = squares
    return by_component.sum(-1).numpy()
