"""Listed causes that explain what a stated one explains nearly as well, once they are fitted in full.

The draws compare causes by a model that is linear about one fit. Of a cause with a free shape it knows little elsewhere: the best place of
another piece of iron may be far away. So the likeliest others are fitted in the place of such a cause, and their evidence counts as that of
the model about their own fits. So are others that come close to a cause without one, for changes are curved: of a base that stands 2 mm off
there is a fit, of a probe that does derivatives alone.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import NamedTuple

import torch

from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.mixture.asked import Asked
from estimator.diagnosis.mixture.climb import noise_prior
from estimator.diagnosis.mixture.comparison import Comparison
from estimator.diagnosis.mixture.dictionary import dictionary
from estimator.diagnosis.mixture.evidence import Products
from estimator.diagnosis.mixture.expansion import Expansion
from estimator.diagnosis.mixture.listed import present_items
from estimator.diagnosis.mixture.slots import Samples, Slots
from estimator.effects import EFFECTS
from estimator.rig.rig import Cause

MOST_RIVALS = 4  # of one cause, by their evidence in the linear model
# Of the log Bayes factor of a cause with a free shape, with less of which a full fit does not reach it; and of that of others, of which
# full fits with a probe or a base 5 mm off gained up to 4.5 %.
LEAST_EVIDENCE, LEAST_CURVED = 0.5, 0.95


class Rival(NamedTuple):
    """A cause in the place of a stated one.

    Attributes:
        item: Number of the item that stands for it.
        log_odds: Against the stated cause, each by the model about its own fit.
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


def contenders(comparison: Comparison, stated: Cause, others: Collection[Cause]) -> list[int]:
    """Numbers of the items at whose shapes fits of possible rivals start: of causes whose evidence is not far below that of a stated one.

    Args:
        comparison: All hypotheses in its place.
        stated: The cause.
        others: Causes that are no rivals.
    """
    extent = comparison.asked.expansion.fit.circumstances.extent
    has_shape = any(q.is_shape and not q.is_fixed for q in EFFECTS[stated.name].quantities(extent))
    known = {stated, *others, *(() if has_shape else comparison.taken)}
    factors = {h.cause: h.log_bayes_factor for h in comparison.hypotheses if h.cause is not None}
    least = (LEAST_EVIDENCE if has_shape else LEAST_CURVED) * factors[stated]
    able = sorted((c for c in factors if factors[c] > least and c not in known), key=lambda c: -factors[c])
    return [comparison.best_item(cause) for cause in able[:MOST_RIVALS]]


def rival(asked: Asked, item: int, fit: Fit, stated: Mapping[Cause, int], own: Fit) -> Rival:
    """A cause in the place of a stated one, judged by its fit and that with the stated one.

    Args:
        asked: What was asked.
        item, fit: At whose shapes the fit with it started, and this fit.
        stated: Items that stand for the stated causes.
        own: The fit with these.
    """
    items, known = asked.dictionary.items, asked.expansion.log_prior
    cause = items[item].cause
    log_prior = {c: known.get(c, items[i].log_prior_of_start) for c, i in {**stated, cause: item}.items()}
    log_odds = _log_density(asked, fit, log_prior) - _log_density(asked, own, log_prior)
    shapes = {key: float(fit.values[name]) for key, name in fit.rig.names_of(cause).items()}
    return Rival(cause, item, log_odds, shapes)


def _log_density(asked: Asked, fit: Fit, log_prior: Mapping[Cause, float]) -> float:
    """Log density of the readings of a fit and the most probable quantities and widths of its causes, in the model about it."""
    plain = asked.expansion.plain
    expansion = Expansion(plain, fit, torch.zeros_like(plain.predicted_T), log_prior)
    entries = dictionary(expansion, present_items(expansion.present), ())
    slots = Slots(Products(entries), noise_prior(fit), len(expansion.causes))
    about = Asked(expansion, (), entries, None, slots, Samples(len(entries.items)))
    return about.highest_with(expansion.causes)
