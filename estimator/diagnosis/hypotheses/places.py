"""The place from which something acts, between the coarse places that a cause starts from.

A piece of iron between two of them showed a quarter of its evidence at the nearer one, and was not fitted.
"""

from __future__ import annotations

from collections.abc import Mapping

from torch import Tensor

from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.hypotheses.candidates import at_starts
from estimator.diagnosis.hypotheses.screening import Screened, linear_evidence
from estimator.effects import EFFECTS
from estimator.effects.base import Quantity
from estimator.rig.parameters import Uniform
from estimator.rig.rig import Cause

# Rounds of a search for the best place, and shares of the width of its prior that it begins and ends with.
MOST_ROUNDS = 12
FIRST_STEP, LAST_STEP = 0.1, 0.01


def at_nearer_place(fit: Fit, screened: Screened) -> Screened:
    """What the linear model says of a cause at the best place near its best coarse start, by a compass search.

    Only the start and its evidence change: what the screening says of the cause on average stays, for a finer place is not more probable by
    itself.

    Args:
        fit: Without the cause.
        screened: At its best coarse start; returned as it is where the cause has no place.
    References: Kolda, Lewis and Torczon, SIAM Review 45, 385 (2003), for compass searches.
    """
    places = _places(fit, screened.start.cause)
    value, highest, start = screened
    step = FIRST_STEP
    for _ in range(MOST_ROUNDS if places else 0):
        around = [
            {**start.shapes, q.key: start.shapes.get(q.key, q.null) + side * step * (upper - lower)}
            for q, lower, upper in places
            for side in (-1.0, 1.0)
        ]
        inside = [
            shapes
            for shapes in around
            if all(lower < shapes.get(q.key, q.null) < upper for q, lower, upper in places)
        ]
        nearer = at_starts(fit, start.cause, inside)
        evidence = linear_evidence(fit, nearer)
        best = max(evidence, default=highest)
        if best > highest:
            highest, start = best, nearer[evidence.index(best)]
        elif (step := 0.5 * step) < LAST_STEP:
            break
    return Screened(value, highest, start)


def at_known_place(fit: Fit, screened: Screened, reached: Mapping[str, Tensor]) -> Screened:
    """What the linear model says of a cause where an earlier comparison has found it, if that is more than at its best coarse start.

    Args:
        fit: Without the cause.
        screened: At its best coarse start; returned as it is where the cause has no place.
        reached: The cause's own parameters there.
    """
    label = screened.start.cause.label
    known = {q.key: float(reached[f"{label}.{q.key}"]) for q, _, _ in _places(fit, screened.start.cause)}
    for start in at_starts(fit, screened.start.cause, [{**screened.start.shapes, **known}]) if known else []:
        (highest,) = linear_evidence(fit, [start])
        if highest > screened.highest:
            return Screened(screened.log_bayes_factor, highest, start)
    return screened


def _places(fit: Fit, cause: Cause) -> list[tuple[Quantity, float, float]]:
    """What says where a cause acts, with its bounds; nothing where that is a single number, whose starts lie densely."""
    extent = fit.posterior.model.circumstances.extent
    places = [
        (q, q.prior.lower, q.prior.upper)
        for q in EFFECTS[cause.name].quantities(extent)
        if q.is_shape and not q.is_fixed and isinstance(q.prior, Uniform)
    ]
    return places if len(places) > 1 else []
