"""One declaration and one function make an effect.

The function and all hooks take those arguments of their stage (`effects.stages`) that they need, by name. What needs several functions may
as well be a class of the stage, with the same names as attributes.
"""

from __future__ import annotations

import inspect
import types
from collections.abc import Callable
from typing import Any, Required, TypedDict, TypeVar, Unpack, cast

from estimator.effects.base import Effect, Kind, Quantities, Starts
from estimator.effects.circumstances import Extent
from estimator.errors import InvalidInput
from estimator.rig.rig import Rig

E = TypeVar("E", bound=Effect)
Function = Callable[..., Any]


class Hooks(TypedDict, total=False):
    """What a cause may say of itself; `Effect` and its stages say what each means, and have a default.

    Hooks are functions of what the method of that name has as arguments, or of some of these.
    """

    kind: Kind
    places: Callable[[Rig], tuple[str, ...]]
    starts: Starts | Callable[..., Starts]
    concerns: Callable[..., bool]
    unseen: Callable[..., frozenset[str]]
    broken_rule: Callable[..., tuple[str, str] | None]
    is_itself: Callable[..., bool]
    extent_of: Callable[..., Extent]
    columns: Function
    columns_of: Function
    drive: Function
    exposure: Function
    disturbed_T: Function
    beyond_the_moment: Callable[[str], str | None]
    depends_on: str
    never_negative: tuple[str, ...]
    positive: tuple[str, ...]
    is_record_mistake: bool
    is_structural: bool
    is_linear: bool
    is_everywhere: bool
    can_begin: bool
    couples_coils: bool
    exchanges_coils: bool
    is_permanent: bool
    is_background: bool
    is_at_reference: bool
    is_step: bool
    needs_winding: bool
    goes_with_current: bool


class Declaration(Hooks):
    """What every cause says of itself, besides what it may say."""

    name: Required[str]
    words: Required[str]
    source: Required[str]
    quantities: Required[Quantities | Callable[[Extent], Quantities]]


def cause(
    stage: type[E], method: str | None = None, /, **declared: Unpack[Declaration]
) -> Callable[[Function], E]:
    """Make an effect of a function, whose docstring explains it in reports and `coilcal explain`.

    Args:
        stage: Where it acts: a class of `effects.stages`.
        method: What of the stage the function is; needed where the stage has several, as the room has steady and drifting fields.
        **declared: What it says of itself. Quantities and starts are given as they are, or as functions where they depend on the session.
    Returns: What makes the effect of the function.
    Raises:
        InvalidInput: It is not clear what of the stage the function is, or one takes an argument that the stage does not give.
    Examples:
        >>> from estimator.effects.base import normal
        >>> from estimator.effects.stages import ReadingEffect
        >>> @cause(
        ...     ReadingEffect,
        ...     name="bent_amplifier",
        ...     words="both signs of a large field read too high",
        ...     source="amplifiers of this kind, 2 % at the end of the range",
        ...     quantities=lambda extent: (normal("excess_per_T", "1/T", 0.02 / extent.largest_field_T),),
        ... )
        ... def bent_amplifier(field_sensor_T, theta):
        ...     '''The amplifier bends.'''
        ...     return field_sensor_T + theta["excess_per_T"][..., None, None] * field_sensor_T**2
        >>> bent_amplifier.words
        'both signs of a large field read too high'
    """

    def joined(function: Function) -> E:
        given = cast(dict[str, Any], declared)
        left_open = {method} if method else stage.__abstractmethods__ - given.keys()
        if len(left_open) != 1 or not hasattr(stage, *left_open):
            raise InvalidInput(
                f"function of {given['name']} must be one that {stage.__name__} leaves open; "
                f"received {' and '.join(sorted(left_open)) or 'none'}"
            )
        (name,) = left_open
        return made(stage, {**given, name: function}, function.__module__, inspect.getdoc(function))

    return joined


def made(stage: type[E], declared: dict[str, Any], module: str, explanation: str | None) -> E:
    """The effect of a stage with these attributes and methods; what else is called is of the stage.

    Args:
        stage: A class of `effects.stages`, or one derived from it.
        declared: As `Declaration` has it; functions take arguments by name.
        module: Where it is declared.
        explanation: What it is, in a sentence or more.
    """
    attributes = {key: _attribute(stage, key, value, declared["name"]) for key, value in declared.items()}
    attributes |= {"__module__": module, "__doc__": explanation, "__reduce__": _reduced}
    declared_stage: Any = types.new_class(
        declared["name"], (stage,), exec_body=lambda body: body.update(attributes)
    )
    return cast(E, declared_stage())


def _attribute(stage: type[Effect], key: str, value: Any, name: str) -> Any:
    method = getattr(stage, key, None)
    if not inspect.isfunction(method):
        return value
    if not callable(value):
        return lambda *_: value
    given = list(inspect.signature(method).parameters)
    needed = [
        each.name for each in inspect.signature(value).parameters.values() if each.default is each.empty
    ]
    unknown = [argument for argument in needed if argument not in given[1:]]
    if unknown:
        raise InvalidInput(
            f"{key} of {name} must take some of {', '.join(given[1:])}; received {', '.join(unknown)}"
        )
    numbers = [given.index(argument) for argument in needed]

    def called(*arguments: Any) -> Any:
        return value(*(arguments[number] for number in numbers))

    called.__wrapped__ = value  # type: ignore[attr-defined]
    return called


def _reduced(effect: Effect) -> tuple[Callable[[str], Effect], tuple[str]]:
    """How another process finds the effect."""
    from estimator.effects import effect_of

    return effect_of, (effect.name,)
