"""Listed causes that explain what a stated one explains nearly as well, once they are fitted in full.

Linear models about a fit that has one piece of iron know little of another kind of it: its best place is somewhere else. So the likeliest
others are fitted instead, and their evidence counts as that of full fits. Both have a place or another free shape: of causes without one
linear models know all that there is, and with sizes beyond the stated prior, which full fits have not.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import NamedTuple

from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.mixture.comparison import Comparison
from estimator.effects import EFFECTS
from estimator.rig.rig import Cause

MOST_RIVALS = 2  # of one cause, by their evidence in the linear model
LEAST_EVIDENCE = 0.5  # of the log Bayes factor of the cause: with less a full fit does not reach it


class Rival(NamedTuple):
    """A cause in the place of a stated one.

    Attributes:
        item: Number of the item that stands for it.
        log_odds: Log evidence of its full fit less that of the fit with the stated cause.
        shapes: As fitted.
    """

    cause: Cause
    item: int
    log_odds: float
    shapes: dict[str, float]

    @property
    def odds(self) -> float:
        """How many times more probable it is than the stated cause."""
        return math.exp(min(self.log_odds, 100.0))


class Contender(NamedTuple):
    """A cause that may be a rival, with the item at whose shapes its fit starts."""

    cause: Cause
    item: int


def contenders(comparison: Comparison, stated: Cause, others: Collection[Cause]) -> list[Contender]:
    """Causes with free shapes whose evidence in the place of a stated one is not far below its own.

    Args:
        comparison: All hypotheses in its place.
        stated: The cause.
        others: Causes that are no rivals.
    """
    factors = {h.cause: h.log_bayes_factor for h in comparison.hypotheses if h.cause is not None}
    least = LEAST_EVIDENCE * factors[stated]
    extent = comparison.asked.expansion.fit.posterior.model.circumstances.extent

    def has_shape(cause: Cause) -> bool:
        return any(q.is_shape and not q.is_fixed for q in EFFECTS[cause.name].quantities(extent))

    if not has_shape(stated):
        return []
    able = [
        cause
        for cause, value in factors.items()
        if value > least and cause not in (stated, *others) and has_shape(cause)
    ]
    able.sort(key=lambda cause: -factors[cause])
    return [Contender(cause, comparison.best_item(cause)) for cause in able[:MOST_RIVALS]]


def rival(contender: Contender, fit: Fit, stated: Fit) -> Rival:
    """A contender, judged by its fit and that with the stated cause."""
    prefix = f"{contender.cause.label}."
    shapes = {
        name.removeprefix(prefix): float(value)
        for name, value in fit.values.items()
        if name.startswith(prefix)
    }
    return Rival(contender.cause, contender.item, fit.log_evidence - stated.log_evidence, shapes)
