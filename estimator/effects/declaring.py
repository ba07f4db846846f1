"""How declarations become effects: an object of a class of its own, which its attributes and functions make.

The docstring of a declared function is part of the declaration. Its first line says in words what has happened, a last paragraph that
begins with `Source:` where the width of the priors comes from, and what is between explains it.
"""

from __future__ import annotations

import inspect
import types
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

from estimator.errors import InvalidInput, closest

Function = Callable[..., Any]
S = TypeVar("S")  # a stage
SOURCE = "Source: "


def made(
    stage: type[S],
    function: Function,
    declared: Mapping[str, Any],
    method: str | None = None,
    source: str = "",
) -> S:
    """The effect of a stage that has the name of a function; what else is called is of the stage.

    Args:
        stage: A class of `effects.stages`, or one derived from it.
        function: Its docstring explains the effect.
        declared: Attributes of the stage, and functions in place of its methods. A function takes those arguments of the method that it
            needs, by name; what stands in place of a method and is no function is what the method returns.
        method: In place of which method the function stands; None where it only explains.
        source: Where the width of the priors comes from unless the declaration says so.
    Raises:
        InvalidInput: The stage has no such attribute, a function takes an argument that the stage does not give, or words are missing.
    """
    name = function.__name__.strip("_")
    explanation, said = _said(inspect.getdoc(function) or "", declared)
    declared = {"source": source, **said, **declared, **({method: function} if method else {})}
    known = {*dir(stage), *(key for each in stage.__mro__ for key in getattr(each, "__annotations__", ()))}
    for key in declared.keys() - known:
        raise InvalidInput(
            f"{name} must declare attributes of {stage.__name__}; received {key}{closest(key, known)}"
        )
    if not (declared["words"] and declared["source"]):
        raise InvalidInput(
            f"{name} must have a docstring with words in its first line and a last paragraph 'Source: ...'; received {explanation!r}"
        )
    attributes = {key: _attribute(stage, key, value, name) for key, value in declared.items()}
    if method is not None and not str(function.__module__).startswith("estimator."):
        attributes[method] = _of_shape(attributes[method], name)
    attributes |= {"name": name, "__module__": function.__module__, "__doc__": explanation}
    attributes["__reduce__"] = _reduced
    declared_class: Any = types.new_class(name, (stage,), exec_body=lambda body: body.update(attributes))
    return declared_class()


def _said(docstring: str, declared: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    """Explanation, and words and source of a docstring where they are not declared; words alone are the explanation too."""
    paragraphs, said = docstring.split("\n\n"), {}
    if paragraphs[-1].startswith(SOURCE):
        said["source"] = paragraphs.pop().removeprefix(SOURCE).replace("\n", " ").removesuffix(".")
    if "words" not in declared:
        first = "".join(paragraphs[:1]).replace("\n", " ").removesuffix(".")
        said["words"] = first[:1].lower() + first[1:]
        paragraphs = paragraphs[1:] or paragraphs
    return "\n\n".join(paragraphs), said


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


def _of_shape(method: Function, name: str) -> Function:
    """A method whose answer has as many components as what it changes, or as the points that it is asked at."""

    def checked(*arguments: Any) -> Any:
        answer = method(*arguments)
        like = next((each for each in arguments[1:3] if hasattr(each, "shape")), None)
        if like is not None and hasattr(answer, "shape") and answer.shape[-1:] != like.shape[-1:]:
            raise InvalidInput(
                f"{name} must give as many numbers along the last axis as it is given; it gives {tuple(answer.shape)} "
                f"for {tuple(like.shape)}"
            )
        return answer

    checked.__signature__ = inspect.signature(method)  # type: ignore[attr-defined]
    checked.__wrapped__ = method  # type: ignore[attr-defined]
    return checked


def _reduced(effect: Any) -> tuple[Callable[[str], object], tuple[str]]:
    """How another process finds the effect."""
    from estimator.effects import effect_of

    return effect_of, (effect.name,)
