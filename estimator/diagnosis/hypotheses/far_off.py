"""Causes that lie far from their null: asked by full fits where a fit has bent the rig to follow something large.

A coil whose iron core nobody mentioned has several times its field. A fit without the core moves the coil by centimetres, and what the
linear model says there is of no use for naming what is missing.
"""

from __future__ import annotations

from itertools import zip_longest

from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.hypotheses.several_places import fit_with_needed
from estimator.effects import EFFECTS
from estimator.effects.attach import with_effect
from estimator.rig.rig import Cause


def with_far_off(fit: Fit, least: float) -> Fit | None:
    """The fit with a cause that starts far from its null, at all places that it can have and is needed at; None where none is.

    Args:
        fit: Bent or not; only of a bent one anything is asked.
        least: Log evidence that a cause needs.
    """
    if not fit.is_bent:
        return None
    fits = [
        wider
        for name, effect in EFFECTS.items()
        if effect.starts_far_off
        for wider in _from_all_starts(fit, name, least)
        if wider.log_evidence - fit.log_evidence > least
    ]
    return max(fits, key=lambda wider: wider.log_evidence, default=None)


def _from_all_starts(fit: Fit, name: str, least: float) -> list[Fit]:
    """The fit with one cause at all its places, from the first starts of all, the second, and so on."""
    effect, circumstances = EFFECTS[name], fit.posterior.model.circumstances
    causes = [
        cause
        for place in effect.places(fit.rig)
        if (cause := Cause(name, place)) not in fit.rig.effects and effect.concerns(circumstances, place)
    ]
    fits: list[Fit] = []
    for shapes in zip_longest(*(effect.starts(circumstances, cause.place) for cause in causes)):
        rig = fit.rig
        for cause, start in zip(causes, shapes, strict=True):
            rig = with_effect(rig, cause, fit.observations, start or {})
        fits.append(fit_with_needed(fit, rig, causes, least))
    return fits
