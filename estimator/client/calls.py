"""Methods that are written once as coroutines: `Client` and what it gives wait for them, those of `AsyncClient` are awaited."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from functools import wraps
from typing import Any, Concatenate, Generic, ParamSpec, TypeVar, overload

P = ParamSpec("P")
T = TypeVar("T")


class Waits:
    """A class whose calls wait for the service; its `connection` is a `Connection`."""


class Awaits:
    """A class whose calls are awaited; its `connection` is an `AsyncConnection`."""


class Call(Generic[P, T]):
    """Makes a coroutine method a call: the connection of its object carries it out."""

    def __init__(self, method: Callable[Concatenate[Any, P], Coroutine[Any, Any, T]]) -> None:
        self._method = method

    @overload
    def __get__(self, instance: None, owner: type) -> Callable[..., Any]: ...

    @overload
    def __get__(self, instance: Waits, owner: type) -> Callable[P, T]: ...

    @overload
    def __get__(self, instance: Awaits, owner: type) -> Callable[P, Coroutine[Any, Any, T]]: ...

    def __get__(self, instance: Any, owner: type) -> Any:
        if instance is None:
            return self._method
        method = self._method.__get__(instance, owner)

        @wraps(method)
        def call(*args: P.args, **kwargs: P.kwargs) -> Any:
            return instance.connection.run(method(*args, **kwargs))

        return call
