"""Causes as users write them: `axis_gain[hall].x=0.01` becomes an effect of the rig that makes the readings."""

from __future__ import annotations

import re
from collections.abc import Mapping

from estimator.effects import effect_of
from estimator.effects.attach import with_effect
from estimator.effects.circumstances import Circumstances
from estimator.errors import InvalidInput, closest, quoted
from estimator.readings.observations import Observations
from estimator.rig.rig import Cause, Rig

WRITTEN = re.compile(r"(?P<name>\w+)(\[(?P<place>\w+)\])?(\.(?P<key>\w+))?$")


def with_hidden(rig: Rig, observations: Observations, hidden: Mapping[str, float]) -> Rig:
    """The rig with causes at given sizes, nothing of them free.

    Args:
        rig: Has none of them yet.
        observations: Poses, currents and times of the session that is to be simulated.
        hidden: `cause`, `cause[place]`, `cause.quantity` or `cause[place].quantity`: value in SI. Without quantity it is the first one
            that the cause declares; shapes that are not given are those that a fit would start from.
    Raises:
        InvalidInput: A cause, place or quantity does not exist, or the place is left open where there are several.
    """
    sizes: dict[Cause, dict[str, float]] = {}
    for text, value in hidden.items():
        cause, key = _read(text, rig)
        sizes.setdefault(cause, {})[key] = value
    for cause, given in sizes.items():
        circumstances, effect = Circumstances(rig, observations), effect_of(cause.name)
        keys = {quantity.key for quantity in effect.quantities(circumstances.extent)}
        absent = next((key for key in given if key not in keys), None)
        if absent is not None:
            raise InvalidInput(f"{cause.label} must act in a segment that the session has; received {absent}")
        shapes = effect.starts(circumstances, cause.place)[0]
        rig = with_effect(rig, cause, observations, {**shapes, **given}, is_free=False)
    return rig


def with_truth(rig: Rig, truth: Mapping[str, float]) -> Rig:
    """The rig at the values that are true in a simulated world.

    Raises:
        InvalidInput: The truth names an unknown parameter, or is no possible rig.
    """
    real = rig.with_values(truth)
    broken = real.broken_rule()
    if broken is not None:
        raise InvalidInput(f"truth: {broken[0]} {broken[1]}; received {broken[2]} (rig {rig.name!r})")
    return real


def full_names(rig: Rig, hidden: Mapping[str, float]) -> dict[str, float]:
    """Hidden sizes by the names of parameters of an extended rig: `axis_gain[hall].x`."""
    sizes = {}
    for text, value in hidden.items():
        cause, key = _read(text, rig)
        sizes[f"{cause.label}.{key}"] = value
    return sizes


def hidden_shapes(rig: Rig, observations: Observations, hidden: Mapping[str, float]) -> dict[str, float]:
    """Places, instants and other shapes of hidden causes, by the names of parameters: those that `hidden` does not give were chosen.

    Args:
        rig, observations, hidden: As in `with_hidden`.
    """
    real = with_hidden(rig, observations, hidden)
    extent = Circumstances(rig, observations).extent
    return {
        name: real.parameters[name].value
        for cause in real.effects
        if cause not in rig.effects
        for quantity in effect_of(cause.name).quantities(extent)
        if quantity.is_shape
        for name in [f"{cause.label}.{quantity.key}"]
    }


def cause_of(text: str, rig: Rig) -> Cause:
    """The cause that `cause` or `cause[place]` means in a rig.

    Raises:
        InvalidInput: There is none, or the place is left open where there are several.
    """
    match = WRITTEN.match(text)
    if match is None:
        raise InvalidInput(f"a cause must look like cause or cause[place]; received {quoted(text)}")
    effect = effect_of(match["name"])
    places = effect.places(rig)
    place = match["place"] or (places[0] if len(places) == 1 else None)
    if place not in places:
        hint = closest(place or "", places)
        raise InvalidInput(
            f"{effect.name} must say where, one of {', '.join(places)}; received {quoted(text)}{hint}"
        )
    return Cause(effect.name, place)


def _read(text: str, rig: Rig) -> tuple[Cause, str]:
    cause = cause_of(text, rig)
    if cause in rig.acting:
        raise InvalidInput(
            f"{cause.label} must not be in the rig already to be hidden; received {quoted(text)}"
        )
    match = WRITTEN.match(text)
    given = match["key"] if match else None
    extent = effect_of(cause.name).extent_of((given,) if given else ())
    keys = [quantity.key for quantity in effect_of(cause.name).quantities(extent)]
    key = given or keys[0]
    if key not in keys:
        raise InvalidInput(
            f"{cause.name} must be given by one of {', '.join(keys)}; received {quoted(text)}{closest(key, keys)}"
        )
    return cause, key
