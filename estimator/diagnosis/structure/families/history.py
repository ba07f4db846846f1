"""Curves in what came before a reading: fields, currents, pauses and moves."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.diagnosis import policy
from estimator.diagnosis.structure.families.collection import Collection
from estimator.diagnosis.structure.families.memory import lingering_T
from estimator.diagnosis.structure.families.unit_field import unit_field_T
from estimator.diagnosis.structure.smooth import legendre, unit_interval
from estimator.model.nominal import gradient_T_per_m


def add_history(collection: Collection) -> None:
    """Add all families of the history."""
    _add_fields_before(collection)
    _add_currents_before(collection)
    _add_pauses(collection)
    _add_moves(collection)


def _add_fields_before(collection: Collection) -> None:
    """The last change of the field, and the exponentially fading sums of all changes."""
    fit, predicted_T = collection.fit, collection.predicted_T
    constant = predicted_T.new_ones(len(predicted_T), 1)
    lingering = [lingering_T(fit, steps) for steps in policy.DECAY_STEPS]
    last_T = before(predicted_T, fit.observations.row) - predicted_T
    for changes_T in (last_T, *(field_T for field_T in lingering if field_T is not None)):
        change = changes_T / changes_T.abs().max().clamp(min=1e-12)
        rolled = [torch.diag_embed(torch.roll(change, k, dims=1)) for k in range(3)]
        collection.add("the readings before", constant, change[:, :, None])
        collection.add("the readings before", constant, torch.cat(rolled, dim=-1))


def before(predicted_T: Float[Tensor, "reading 3"], row: Tensor) -> Float[Tensor, "reading 3"]:
    """Predicted field of the reading taken before each one, among the given readings."""
    order = torch.argsort(row)
    previous = torch.empty_like(order)
    previous[order[1:]] = order[:-1]
    previous[order[0]] = order[0]
    return predicted_T[previous]


def _add_currents_before(collection: Collection) -> None:
    """Hysteresis: what stays of the last other current, its sign and the last turning point, as a field of the coil or a constant."""
    observations = collection.fit.observations
    for i, coil in enumerate(collection.fit.rig.coils):
        current_A = observations.history.current_A[:, i]
        scale_A = current_A.abs().max()
        if not bool((current_A != current_A[0]).any()):
            continue
        last = last_other(current_A)[observations.row] / scale_A
        turned = last_turning_point(current_A)[observations.row] / scale_A
        memory = torch.stack((last, torch.sign(last), turned), dim=1)
        name = f"the currents of {coil.name} before"
        collection.add(name, memory, unit_field_T(collection.fit, i)[:, :, None])
        collection.add(name, memory, collection.axes)


def last_other(values: Float[Tensor, " reading"]) -> Float[Tensor, " reading"]:
    """The last value before each that differs from it; 0 where there is none.

    Examples:
        >>> last_other(torch.tensor([1.0, 1.0, 2.0, 2.0, 0.0])).tolist()
        [0.0, 0.0, 1.0, 1.0, 2.0]
    """
    previous = torch.zeros_like(values)
    for k in range(1, len(values)):
        previous[k] = previous[k - 1] if values[k] == values[k - 1] else values[k - 1]
    return previous


def last_turning_point(values: Float[Tensor, " reading"]) -> Float[Tensor, " reading"]:
    """The last local extreme before each value; 0 where there is none.

    Examples:
        >>> last_turning_point(torch.tensor([1.0, 3.0, 2.0, 1.0, 4.0])).tolist()
        [0.0, 0.0, 3.0, 3.0, 1.0]
    """
    result = torch.zeros_like(values)
    direction, extreme = 0.0, 0.0
    for k in range(1, len(values)):
        step = float(torch.sign(values[k] - values[k - 1]))
        if step and direction and step != direction:
            extreme = float(values[k - 1])
        direction = step or direction
        result[k] = extreme
    return result


def _add_pauses(collection: Collection) -> None:
    """The time since the reading before."""
    observations = collection.fit.observations
    time_s = observations.history.time_s
    pause_s = torch.diff(time_s, prepend=time_s[:1])
    pause_s[0] = pause_s[1:].median() if len(pause_s) > 1 else 0.0
    pause = torch.log(pause_s[observations.row].clamp(min=1e-3))[:, None]
    if float(pause.max() - pause.min()) < policy.LEAST_PAUSE_RANGE:
        return
    curves = legendre(unit_interval(pause)[:, 0], policy.SETTING_DEGREE)[:, 1:]
    for vectors in (collection.axes, collection.along_field):
        collection.add("the pause before a reading", curves, vectors)


def _add_moves(collection: Collection) -> None:
    """Errors of position that depend on the last move: its direction, side of approach and length."""
    fit = collection.fit
    model = fit.posterior.model
    for mover in fit.rig.movers:
        move_m = model.circumstances.last_move_m(mover.name)
        length_m = move_m.norm(dim=-1, keepdim=True)
        if not bool((length_m > 0.0).any()):
            continue
        sides = model.circumstances.approach(mover.name)
        curves = torch.cat((move_m / length_m.max(), sides, length_m / length_m.max()), dim=1)
        slope = gradient_T_per_m(model, fit.values, mover.name)
        collection.add(f"the last move of {mover.name}", curves, slope)
