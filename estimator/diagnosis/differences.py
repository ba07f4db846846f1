"""The difference of two quantities of a cause, where readings determine it better than any quantity alone.

A gain of all axes alike is nearly a coil with more turns, and a displacement of all Hall elements alike is one of the sensor. What readings
know of such a cause is how its quantities differ.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from estimator.calibration.result import Calibration
from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.sizes import Difference, Interval
from estimator.diagnosis.widening import Widening
from estimator.effects import EFFECTS
from estimator.effects.base import Quantity
from estimator.readings.metrics import HALF_WIDTH_90
from estimator.rig.rig import Cause


def clearest_difference(
    fit: Fit, cause: Cause, posterior: Calibration | None, widening: Widening | None
) -> Difference | None:
    """The difference of two quantities that is farthest from zero in its standard deviations; None where a quantity alone is nearly as far.

    Args:
        fit: Of the extended rig.
        cause: One of its causes.
        posterior: Its draws, where it was sampled; else Laplace's approximation serves.
        widening: Of Laplace's intervals, by what remains unexplained.
    """
    circumstances = fit.posterior.model.circumstances
    unseen = EFFECTS[cause.name].unseen(circumstances, cause.place)
    sizes = [
        quantity
        for quantity in EFFECTS[cause.name].quantities(circumstances.extent)
        if not quantity.is_shape and quantity.key not in unseen and _is_free(fit, cause, quantity)
    ]
    distance = {_name(cause, q): abs(float(fit.values[_name(cause, q)]) - q.null) for q in sizes}
    alone = [distance[name] / fit.value_sd(name) for name in distance]
    best: Difference | None = None
    for first, second in combinations(sizes, 2):
        if first.unit != second.unit or first.null != second.null:
            continue
        farther, nearer = sorted(
            (_name(cause, first), _name(cause, second)), key=lambda name: -distance[name]
        )
        difference = _difference(fit, cause, (farther, nearer), first.unit, posterior, widening)
        if best is None or difference.distance_sd > best.distance_sd:
            best = difference
    least = policy.CLEARER_DIFFERENCE * max(alone, default=0.0)
    return best if best is not None and best.distance_sd > max(least, policy.CLEAR_SD) else None


def _name(cause: Cause, quantity: Quantity) -> str:
    return f"{cause.label}.{quantity.key}"


def _is_free(fit: Fit, cause: Cause, quantity: Quantity) -> bool:
    parameter = fit.rig.parameters.get(_name(cause, quantity))
    return parameter is not None and parameter.is_free


def _difference(
    fit: Fit,
    cause: Cause,
    names: tuple[str, str],
    unit: str,
    posterior: Calibration | None,
    widening: Widening | None,
) -> Difference:
    if posterior is not None and all(name in posterior.draws for name in names):
        draws = posterior.draws[names[0]] - posterior.draws[names[1]]
        low, median, high = (float(end) for end in np.quantile(draws, (0.05, 0.5, 0.95)))
        interval = Interval(median, float(draws.std(ddof=1)), (low, high), unit)
    else:
        median = float(fit.values[names[0]] - fit.values[names[1]])
        factor = 1.0 if widening is None else max(widening.factors[name] for name in names)
        sd = factor * fit.difference_sd(*names)
        interval = Interval(median, sd, (median - HALF_WIDTH_90 * sd, median + HALF_WIDTH_90 * sd), unit)
    plus, minus = (name.removeprefix(f"{cause.label}.") for name in names)
    return Difference(plus, minus, interval)
