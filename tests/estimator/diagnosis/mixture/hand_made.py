"""Answers whose draws are made by hand, about a real fit with all its items."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from estimator.diagnosis.mixture.answer import Answer
from estimator.diagnosis.mixture.asked import Asked
from estimator.diagnosis.mixture.slots import Samples
from estimator.rig.rig import Cause

Drawn = Mapping[tuple[Cause, ...], float]


def said(
    asked: Asked,
    drawn: Drawn,
    slots: Sequence[Mapping[Cause, float]] = (),
    in_halves: Sequence[Drawn] = (),
) -> Answer:
    """An answer with these draws.

    Args:
        asked: At the rig as described. Each cause and departure stands for its most probable item.
        drawn: How often each set of these was drawn.
        slots: What alternates with each other, as shares; what is in none of these has its slot for itself.
        in_halves: The same as `drawn`, for each half of the readings.
    """
    causes = {cause for models in (drawn, *in_halves) for model in models for cause in model}
    number = {
        cause: _best(asked, cause) for cause in causes | {cause for shares in slots for cause in shares}
    }
    shares_of = {cause: shares for shares in slots for cause in shares}
    n_items = len(asked.dictionary.items)

    def samples(models: Drawn) -> Samples:
        made = Samples(n_items)
        total = sum(models.values())
        made.n, made.noises = int(total), asked.samples.noises
        for model, n in models.items():
            made.models[tuple(sorted(number[cause] for cause in model))] += n
            for cause in model:
                for other, share in shares_of.get(cause, {cause: 1.0}).items():
                    made.conditional[number[other]] += share * n
                    of_slot = made.beside.setdefault(number[cause], np.zeros(n_items))
                    of_slot[number[other]] += share * n
        made.largest = np.minimum(made.conditional, 1.0)
        return made

    return Answer(asked, replace(asked, samples=samples(drawn)), tuple(map(samples, in_halves)))


def _best(asked: Asked, cause: Cause) -> int:
    own = [i for i, item in enumerate(asked.dictionary.items) if item.cause == cause]
    values = asked.slots.products.beside([], 1.0) + asked.slots.log_prior
    return max(own, key=lambda i: float(values[i]))
