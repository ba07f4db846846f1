"""How declarations become effects: an object of a class of its own, which its attributes and functions make."""

from __future__ import annotations

import inspect
import types
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

from estimator.errors import InvalidInput, closest

Function = Callable[..., Any]
S = TypeVar("S")  # a stage


def made(
    stage: type[S], name: str, declared: Mapping[str, Any], module: str | None, explanation: str | None
) -> S:
    """The effect of a stage with these attributes and functions; what else is called is of the stage.

    Args:
        stage: A class of `effects.stages`, or one derived from it.
        name: Stable name of the effect.
        declared: Attributes of the stage, and functions in place of its methods. A function takes those arguments of the method that it
            needs, by name; what stands in place of a method and is no function is what the method returns.
        module: Where it is declared.
        explanation: What it is, in a sentence or more.
    Raises:
        InvalidInput: The stage has no such attribute, or a function takes an argument that the stage does not give.
    """
    known = {*dir(stage), *(key for each in stage.__mro__ for key in getattr(each, "__annotations__", ()))}
    for key in declared.keys() - known:
        raise InvalidInput(
            f"{name} must declare attributes of {stage.__name__}; received {key}{closest(key, known)}"
        )
    attributes = {key: _attribute(stage, key, value, name) for key, value in declared.items()}
    attributes |= {"name": name, "__module__": module, "__doc__": explanation, "__reduce__": _reduced}
    declared_class: Any = types.new_class(name, (stage,), exec_body=lambda body: body.update(attributes))
    effect: S = declared_class()
    return effect


def _attribute(stage: type, key: str, value: Any, name: str) -> Any:
    method = getattr(stage, key, None)
    if not inspect.isfunction(method):
        return value
    function = value if callable(value) else lambda: value
    given = list(inspect.signature(method).parameters)
    parameters = inspect.signature(function).parameters.values()
    needed = [each.name for each in parameters if each.default is each.empty]
    unknown = [argument for argument in needed if argument not in given[1:]]
    if unknown:
        raise InvalidInput(
            f"{key} of {name} must take some of {', '.join(given[1:])}; received {', '.join(unknown)}"
        )
    return _by_name(function, method, [given.index(argument) for argument in needed])


def _by_name(function: Function, method: Function, numbers: Sequence[int]) -> Function:
    """What stands in place of a method and calls a function with those of its arguments."""

    def called(*arguments: Any) -> Any:
        return function(*(arguments[number] for number in numbers))

    called.__signature__ = inspect.signature(method)  # type: ignore[attr-defined]
    called.__wrapped__ = function  # type: ignore[attr-defined]
    return called


def _reduced(effect: Any) -> tuple[Callable[[str], object], tuple[str]]:
    """How another process finds the effect."""
    from estimator.effects import effect_of

    return effect_of, (effect.name,)
