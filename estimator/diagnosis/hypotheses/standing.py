"""Which of many causes of a fit stand beside what it leaves: they are plausible, and keep their evidence beside flexible curves."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.structure.discrepancy import Discrepancy
from estimator.diagnosis.structure.families.collection import Family
from estimator.diagnosis.structure.relatives import unknown_beside
from estimator.effects import EFFECTS
from estimator.rig.rig import Cause


def standing(fit: Fit, causes: Sequence[Cause], before: Discrepancy, remainder: Discrepancy) -> list[Cause]:
    """Causes that stand beside what the fit leaves, judged to first order about the fit.

    Args:
        fit: With all of them.
        causes: Those that are asked.
        before: The strongest curves of a fit without any cause, weighed as the readings are at this fit.
        remainder: Structure in the residual of this fit.
    """
    columns = torch.cat((before.columns, remainder.columns), dim=1)
    return [
        cause
        for cause in causes
        if explains_more_than_is_left(fit, cause, remainder)
        and fit.log_evidence_for(cause, columns) > policy.LEAST_LOG_EVIDENCE_BESIDE_CURVES
    ]


def keeping_their_names(
    fit: Fit,
    causes: Sequence[Cause],
    before: Discrepancy,
    remainder: Discrepancy,
    families: Sequence[Family],
) -> list[Cause]:
    """Causes that stand, and that are rather themselves than something that no list holds.

    The latter is asked only of those that stand.

    Args:
        fit, causes, before, remainder: As in `standing`.
        families: Flexible curves, weighed as the readings are at the fit.
    """
    stand = standing(fit, causes, before, remainder)
    unknown = unknown_beside(fit, stand, families)
    return [
        c
        for c, beside in zip(stand, unknown, strict=True)
        if beside.probability <= policy.MOST_NOT_IN_LIBRARY
    ]


def explains_more_than_is_left(fit: Fit, cause: Cause, remainder: Discrepancy) -> bool:
    """Whether a cause is plausible, and its evidence is above that for the structure that is left."""
    return is_plausible(fit, cause) and fit.log_evidence_for(cause) > remainder.log_bayes_factor


def is_plausible(fit: Fit, cause: Cause) -> bool:
    """Whether the fitted quantities of a cause lie within a few widths of their priors, which its source states."""
    quantities = EFFECTS[cause.name].quantities(fit.posterior.model.circumstances.extent)
    free = set(fit.posterior.coordinates.names)
    return all(
        abs(q.prior.distance(float(fit.values[name]))) <= policy.PLAUSIBLE_SD
        for q in quantities
        if not q.is_shape and (name := f"{cause.label}.{q.key}") in free
    )
