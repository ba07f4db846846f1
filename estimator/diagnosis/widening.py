"""How much wider intervals are for what remains unexplained."""

from __future__ import annotations

import numpy as np

from estimator.diagnosis.cross_validation import jackknife_covariance
from estimator.diagnosis.discrepancy import Discrepancy
from estimator.diagnosis.fitting import Fit
from estimator.split import blocks_of_places


def widening(searched: Fit, fit: Fit, left: Discrepancy) -> dict[str, float]:
    """By which factor the standard deviation of each free parameter grows where structure is left that no cause explains.

    The largest of three counts: that of the fit; that of the search if the strongest curve that is left may be in the readings as well;
    and that by which blocks of neighbouring places disagree. The last two are of the few readings of the search, for what a wrong model
    leaves does not average out over more.

    Args:
        searched: The last fit of the search.
        fit: The same model, fitted to all readings: its standard deviations grow.
        left: What the search left.
    """
    block = blocks_of_places(searched.observations, np.random.default_rng(0))
    covariances = (searched.covariance_beside(left.columns), jackknife_covariance(searched, block))
    return {
        name: max(1.0, *(searched.value_sd(name, one) / fit.value_sd(name) for one in covariances))
        for name in (parameter.name for parameter in fit.rig.free)
    }
