"""Numbers of the extended rig with their intervals: from posterior draws where it was sampled, else by Laplace, widened by what is left."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from estimator.calibration.result import Calibration
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.sizes import Difference, Interval
from estimator.diagnosis.widening import Widening
from estimator.effects import EFFECTS
from estimator.readings.metrics import HALF_WIDTH_90
from estimator.rig.parameters import Prior
from estimator.rig.rig import Cause

# Factor between two numbers of standard deviations, or two of these, from which on the difference is told
CLEARLY_LARGER = 1.5
CLEAR_SD = 2.0  # standard deviations from zero from which on a number of a cause is told in a sentence

STEP = 1e-3  # of a standard deviation, for the derivative of a prior's distance
MOSTLY_PRIOR = 0.8  # of the prior's standard deviation, from which on a number is told to be mostly its prior


@dataclass(frozen=True)
class Intervals:
    """Intervals of the numbers of an extended rig.

    Attributes:
        fit: Of the extended rig.
        posterior: Its draws, where it was sampled.
        widening: Of Laplace's intervals, by what remains unexplained.
    """

    fit: Fit
    posterior: Calibration | None = None
    widening: Widening | None = None

    def sd(self, *names: str) -> float:
        """Standard deviation by Laplace, widened: of a free number, or of the difference of two."""
        factor = 1.0 if self.widening is None else max(self.widening.factors[name] for name in names)
        return factor * (self.fit.value_sd(*names) if len(names) == 1 else self.fit.difference_sd(*names))

    def of(self, name: str) -> Interval:
        """Interval of a number, within the bounds of its prior."""
        parameter = self.fit.rig.parameters[name]
        sampled = {} if self.posterior is None else self.posterior.summary()["parameters"]
        if name in sampled:
            median, sd, (low, high) = (sampled[name][key] for key in ("median", "sd", "ci90"))
        else:
            sd = self.sd(name) if parameter.is_free else 0.0
            median, low, high = _normal(float(self.fit.values[name]), sd)
        is_of_prior = False
        if (prior := parameter.prior) is not None:
            low, high = (min(max(end, prior.lower), prior.upper) for end in (low, high))
            is_of_prior = parameter.is_free and self._of_prior(name, prior) > MOSTLY_PRIOR
        return Interval(median, sd, (low, high), parameter.unit, is_of_prior)

    def _of_prior(self, name: str, prior: Prior) -> float:
        """Standard deviation of a number that is fitted, over that of its prior where the number is: far out, a log-normal one is wide."""
        value, sd = float(self.fit.values[name]), self.fit.value_sd(name)
        return (prior.distance(value + STEP * sd) - prior.distance(value)) / STEP

    def quantities(self, cause: Cause) -> dict[str, Interval]:
        """Quantities of a cause that the session can see, by SI key."""
        names, unseen = self.fit.rig.names_of(cause), self._unseen(cause)
        return {key: self.of(name) for key, name in names.items() if key not in unseen}

    def difference(self, cause: Cause) -> Difference | None:
        """The difference of two quantities that is farthest from zero in its standard deviations.

        A gain of all axes alike is nearly a coil with more turns, and a displacement of all Hall elements alike is one of the sensor. What
        readings know of such a cause is how its quantities differ. None where a quantity alone is nearly as far from its null.
        """
        parameters, unseen = self.fit.rig.parameters, self._unseen(cause)
        named = {
            f"{cause.label}.{quantity.key}": quantity
            for quantity in EFFECTS[cause.name].quantities(self.fit.circumstances.extent)
            if not quantity.is_shape and quantity.key not in unseen
        }
        sizes = {name: q for name, q in named.items() if name in parameters and parameters[name].is_free}
        distance = {name: abs(float(self.fit.values[name]) - q.null) for name, q in sizes.items()}
        differences = [
            self._difference(*sorted(pair, key=lambda name: -distance[name]))
            for pair in combinations(sizes, 2)
            if len({(sizes[name].unit, sizes[name].null) for name in pair}) == 1
        ]
        best = max(differences, key=lambda difference: difference.distance_sd, default=None)
        alone = max((distance[name] / self.fit.value_sd(name) for name in distance), default=0.0)
        least = max(CLEARLY_LARGER * alone, CLEAR_SD)
        return best if best is not None and best.distance_sd > least else None

    def _unseen(self, cause: Cause) -> frozenset[str]:
        """Keys of the quantities of a cause that the session cannot show."""
        return EFFECTS[cause.name].unseen(self.fit.circumstances, cause.place)

    def _difference(self, farther: str, nearer: str) -> Difference:
        if self.posterior is not None and {farther, nearer} <= self.posterior.draws.keys():
            draws = self.posterior.draws[farther] - self.posterior.draws[nearer]
            low, median, high = (float(end) for end in np.quantile(draws, (0.05, 0.5, 0.95)))
            sd = float(draws.std(ddof=1))
        else:
            sd = self.sd(farther, nearer)
            median, low, high = _normal(float(self.fit.values[farther] - self.fit.values[nearer]), sd)
        interval = Interval(median, sd, (low, high), self.fit.rig.parameters[farther].unit)
        plus, minus = (name.rpartition("].")[2] for name in (farther, nearer))
        return Difference(plus, minus, interval)


def _normal(median: float, sd: float) -> tuple[float, float, float]:
    """Median of a normal density, and the ends of its 90 % interval."""
    return median, median - HALF_WIDTH_90 * sd, median + HALF_WIDTH_90 * sd
