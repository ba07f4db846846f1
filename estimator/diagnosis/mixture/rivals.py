"""Listed causes that explain what a stated one explains nearly as well, once they are fitted in full.

The draws compare causes by a model that is linear about one fit. Of a cause with a free shape it knows little elsewhere: the best place of
another piece of iron may be far away. So the likeliest others are fitted in the place of such a cause, and their evidence counts as that of
full fits. Of causes without a free shape the linear model knows all that there is.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import NamedTuple

from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.mixture.comparison import Comparison
from estimator.diagnosis.mixture.expansion import log_odds_of_width
from estimator.effects import EFFECTS
from estimator.rig.rig import Cause

MOST_RIVALS = 4  # of one cause, by their evidence in the linear model
LEAST_EVIDENCE = 0.5  # of the log Bayes factor of the cause: with less a full fit does not reach it


class Rival(NamedTuple):
    """A cause in the place of a stated one.

    Attributes:
        item: Number of the item that stands for it.
        log_odds: Log evidence of its full fit less that of the fit with the stated cause, and its log prior at its start.
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
    """A cause that may be a rival.

    Attributes:
        item: Number of the item at whose shapes its fit starts.
        log_prior: What the start has of its prior, where the fit keeps it; 0 where shapes are free.
    """

    cause: Cause
    item: int
    log_prior: float


def contenders(comparison: Comparison, stated: Cause, others: Collection[Cause]) -> list[Contender]:
    """Causes whose evidence in the place of a stated one with a free shape is not far below its own.

    Args:
        comparison: All hypotheses in its place.
        stated: The cause; without a free shape it has none.
        others: Causes that are no rivals.
    """
    asked = comparison.asked
    extent = asked.expansion.fit.circumstances.extent

    def has_shape(cause: Cause) -> bool:
        return any(q.is_shape and not q.is_fixed for q in EFFECTS[cause.name].quantities(extent))

    if not has_shape(stated):
        return []
    factors = {h.cause: h.log_bayes_factor for h in comparison.hypotheses if h.cause is not None}
    least = LEAST_EVIDENCE * factors[stated]
    able = [c for c, value in factors.items() if value > least and c not in (stated, *others)]
    able.sort(key=lambda cause: -factors[cause])

    def log_prior(cause: Cause) -> float:
        n_starts = sum(candidate.cause == cause for candidate in asked.pool)
        return 0.0 if has_shape(cause) else -math.log(max(n_starts, 1))

    return [Contender(c, comparison.best_item(c), log_prior(c)) for c in able[:MOST_RIVALS]]


def rival(contender: Contender, fit: Fit, stated: Cause, own: Fit) -> Rival:
    """A contender, judged by its fit and that with the stated cause; sizes beyond their stated widths have the prior of those.

    Args:
        contender, fit: A cause in the place of the stated one, and the fit with it.
        stated, own: The stated one, and the fit with that.
    """
    names = fit.rig.names_of(contender.cause)
    shapes = {key: float(fit.values[name]) for key, name in names.items()}
    widths = log_odds_of_width(fit, contender.cause) - log_odds_of_width(own, stated)
    log_odds = fit.log_evidence - own.log_evidence + contender.log_prior + widths
    return Rival(contender.cause, contender.item, log_odds, shapes)
