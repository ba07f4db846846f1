"""What takes long to make and is asked for again: those used last stay in memory."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from typing import Generic, TypeVar

Key = TypeVar("Key")
Value = TypeVar("Value")


class Cache(Generic[Key, Value]):
    """Values by key, one made at a time.

    Args:
        make: Makes the value of a key.
        most: Size of all values that are kept together; the last one stays, whatever its size.
        size: Of a value; by default values are counted.

    Examples:
        >>> made = []
        >>> squares = Cache(lambda n: made.append(n) or n * n, 2)
        >>> [squares[n] for n in (1, 2, 1, 3, 1, 2)]
        [1, 4, 1, 9, 1, 4]
        >>> squares.forget(lambda n: n == 1)
        >>> squares[1]
        1
        >>> made
        [1, 2, 3, 2, 1]
    """

    def __init__(
        self, make: Callable[[Key], Value], most: int, size: Callable[[Value], int] = lambda _: 1
    ) -> None:
        self._make, self._most, self._size = make, most, size
        self._values: OrderedDict[Key, Value] = OrderedDict()
        self._lock = threading.Lock()

    def __getitem__(self, key: Key) -> Value:
        with self._lock:
            value = self._values.pop(key) if key in self._values else self._make(key)
            self._values[key] = value
            while len(self._values) > 1 and sum(map(self._size, self._values.values())) > self._most:
                self._values.popitem(last=False)
            return value

    def forget(self, is_gone: Callable[[Key], bool]) -> None:
        """Drop the values of keys that are gone."""
        with self._lock:
            for key in [key for key in self._values if is_gone(key)]:
                del self._values[key]
