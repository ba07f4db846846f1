"""What was found against what was expected: numbers far from their priors, and sizes that priors hold back."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from estimator.calibration.quality import tensions
from estimator.diagnosis.next_readings.resolution import PLAUSIBLE_SD
from estimator.diagnosis.result import Diagnosis
from estimator.diagnosis.sizes import Interval
from estimator.reporting.numbers import quantity_words, size_with_unit
from estimator.rig.parameters import Normal

MOST_OF_PRIOR = 0.95  # of a prior's sd: what is wider was hardly seen by the readings
MOST_TENSIONS = 3  # that are listed one by one


def tension(diagnosis: Diagnosis) -> Iterator[str]:
    """Numbers of the rig file that lie far from what it expects of them, even with the causes that were found."""
    values = {name: float(value) for name, value in diagnosis.fits.final.values.items()}
    if diagnosis.posterior is not None:  # whole loop counts may pull other numbers farther than real ones do
        values |= {name: float(np.median(draws)) for name, draws in diagnosis.posterior.draws.items()}
    far = tensions(diagnosis.rig.free, values)
    if far:
        n_more = len(far) - MOST_TENSIONS
        rest = f" {n_more} more numbers lie as far." if n_more > 0 else ""
        yield f"Far from what the rig file expects: {' '.join(far[:MOST_TENSIONS])}{rest}"


def held_back(diagnosis: Diagnosis) -> Iterator[str]:
    """Sizes that contradict their priors and would be larger without them by more than their own standard deviation, by cause."""
    for sized in diagnosis.sized_causes:
        held = []
        for key, interval in sized.quantities.items():
            parameter = diagnosis.extended_rig.parameters.get(f"{sized.cause.label}.{key}")
            prior = parameter.prior if parameter is not None else None
            if isinstance(prior, Normal) and (alone := _alone(interval, prior)) is not None:
                size, width, without = (
                    size_with_unit(value, interval.unit) for value in (interval.median, prior.sd, alone)
                )
                held.append(
                    f"its {quantity_words(key)}, {size} with a prior of ± {width}, about {without} without"
                )
        if held:
            yield (
                f"The prior of {sized.name} holds back {'; '.join(held)}. If that is possible, state a wider prior in the rig file."
            )


def _alone(interval: Interval, prior: Normal) -> float | None:
    """The size by the readings alone, where they contradict the prior; None where they do not, or know it no better than the prior.

    For normal densities they say `mean + (median - mean) / (1 - r^2)` with `r = sd / prior sd`, which lies
    `(median - mean) / (prior sd sqrt(1 - r^2))` standard deviations from the prior.
    """
    if not 0.0 < interval.sd < MOST_OF_PRIOR * prior.sd:
        return None
    rest, off = 1.0 - (interval.sd / prior.sd) ** 2, interval.median - prior.mean
    alone = prior.mean + off / rest
    is_contradicted = abs(off) > PLAUSIBLE_SD * prior.sd * math.sqrt(rest)
    return alone if is_contradicted and abs(alone - interval.median) > interval.sd else None
