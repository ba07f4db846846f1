"""What was found against what was expected: numbers far from their priors, and sizes that priors hold back."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from estimator.calibration.quality import tensions
from estimator.diagnosis.result import Diagnosis
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
    """Sizes that would be larger without their priors, by more than their own standard deviation, one sentence each.

    For normal densities the readings alone would say `centre + (median - centre) / (1 - (sd / prior sd)^2)`.
    """
    for sized in diagnosis.sized_causes:
        for key, interval in sized.quantities.items():
            parameter = diagnosis.extended_rig.parameters.get(f"{sized.cause.label}.{key}")
            prior = parameter.prior if parameter is not None else None
            if not isinstance(prior, Normal) or not 0.0 < interval.sd < MOST_OF_PRIOR * prior.sd:
                continue
            alone = prior.mean + (interval.median - prior.mean) / (1.0 - (interval.sd / prior.sd) ** 2)
            if abs(alone - interval.median) > interval.sd:
                size, width, without = (
                    size_with_unit(value, interval.unit) for value in (interval.median, prior.sd, alone)
                )
                yield (
                    f"The prior of {sized.name} holds its {quantity_words(key)} back: {size} with a prior of ± {width}, about {without} "
                    "without. If such a size is possible, state a wider prior in the rig file."
                )
