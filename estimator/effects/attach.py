"""A rig with one more effect, as a hypothesis to fit or as a truth to simulate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from estimator.effects import EFFECTS
from estimator.effects.circumstances import Circumstances
from estimator.readings.observations import Observations
from estimator.rig.parameters import Parameter
from estimator.rig.rig import Cause, Rig


def with_effect(
    rig: Rig,
    cause: Cause,
    observations: Observations,
    values: Mapping[str, float],
    is_free: bool = True,
    circumstances: Circumstances | None = None,
    factor: float = 1.0,
) -> Rig:
    """The rig with an effect: its quantities at given values, else at their null, free or fixed.

    Args:
        rig: Without that effect.
        cause: Name and place.
        observations: Of the session, whose extent sets the priors.
        values: Of some quantities by key, in SI: the shapes that a fit starts from, or all for a simulation. Their keys tell the degree of
            a correction.
        is_free: A fit may change them.
        circumstances: Of the observations, where they are known already.
        factor: On the stated widths of the priors of its sizes.
    """
    effect = EFFECTS[cause.name]
    circumstances = circumstances or Circumstances(rig, observations)
    extent = replace(circumstances.extent, degree=effect.extent_of(values).degree)
    unseen = effect.unseen(circumstances, cause.place)
    parameters = [
        Parameter(
            f"{cause.label}.{quantity.key}",
            quantity.unit,
            values.get(quantity.key, quantity.prior.centre if quantity.is_positive else quantity.null),
            None if quantity.is_fixed or quantity.key in unseen or not is_free else quantity.prior,
            is_positive=quantity.is_positive,
        )
        for quantity in (stated.widened(factor) for stated in effect.quantities(extent))
    ]
    extended = rig.with_correction if effect.is_correction else rig.with_cause
    return extended(cause, parameters)
