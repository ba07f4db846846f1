"""Derivatives of the readings in the quantities of a cause that a rig does not have."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.effects import EFFECTS
from estimator.effects.attach import with_effect
from estimator.effects.base import Quantity
from estimator.effects.circumstances import Circumstances
from estimator.effects.stages import NoiseEffect, ReadingEffect
from estimator.model.measurement_model import MeasurementModel
from estimator.rig.rig import Cause, Rig

STEP = 1e-3  # of the prior's width: central differences of smooth effects


class CauseColumns(NamedTuple):
    """What one cause at one place changes, from each start of its shapes.

    Attributes:
        rig: With the cause, at the first start.
        quantities: That say how large it is, and that the session can show.
        started_T: Predicted readings at each start.
        slope_T: Change of the readings per unit of each quantity.
    """

    rig: Rig
    quantities: tuple[Quantity, ...]
    started_T: Float[Tensor, "start reading 3"]
    slope_T: Float[Tensor, "start quantity reading 3"]


def causes_beside(rig: Rig, circumstances: Circumstances) -> list[Cause]:
    """Continuous causes that a rig does not have and that concern its readings; none that changes their scatter alone."""
    present = set(rig.effects)
    return [
        cause
        for name, effect in EFFECTS.items()
        if not (effect.is_record_mistake or effect.is_correction or isinstance(effect, NoiseEffect))
        for place in effect.places(rig)
        if (cause := Cause(name, place)) not in present and effect.concerns(circumstances, place)
    ]


def cause_columns(
    model: MeasurementModel,
    values: Mapping[str, Tensor],
    cause: Cause,
    starts: Sequence[Mapping[str, float]],
    at_sensor_T: Float[Tensor, "*#batch reading 3"] | None = None,
) -> CauseColumns:
    """Changes of the readings by a cause, from starts of the same shapes: one prediction for all of them.

    Args:
        model: Of the rig without the cause.
        values: Every number of that rig.
        cause: Name and place.
        starts: Its shapes, at least one.
        at_sensor_T: Field at the sensors by the model, where it is known: a cause that changes only what a sensor shows needs no other.
    """
    circumstances, effect = model.circumstances, EFFECTS[cause.name]
    observations = circumstances.observations
    rig = with_effect(model.rig, cause, observations, starts[0], is_free=False, circumstances=circumstances)
    unseen = effect.unseen(circumstances, cause.place)
    quantities = tuple(
        q for q in effect.quantities(circumstances.extent) if q.key not in unseen and not q.is_shape
    )
    beside, at = model.with_effects_of(rig), dict(values)
    steps = observations.current_A.new_tensor([STEP * q.prior.sd for q in quantities])
    ends = torch.cat((torch.diag(steps), -torch.diag(steps), steps.new_zeros(1, len(steps))))
    names = rig.names_of(cause)
    for key, name in names.items():
        each = [shapes.get(key, rig.parameters[name].value) for shapes in starts]
        at[name] = steps.new_tensor(each)[:, None]
    for i, quantity in enumerate(quantities):
        at[names[quantity.key]] = at[names[quantity.key]] + ends[:, i]
    with torch.no_grad():
        field_T = at_sensor_T if isinstance(effect, ReadingEffect) else None
        reading_T = beside.predict(at) if field_T is None else beside.shown_T(at, field_T)
        reading_T = reading_T.expand(len(starts), len(ends), len(observations), 3)
    up_T, down_T = reading_T[:, :-1].chunk(2, dim=1)
    return CauseColumns(rig, quantities, reading_T[:, -1], (up_T - down_T) / (2.0 * steps[:, None, None]))
