"""Reads the settings of a device from a mapping of a rig file; every quantity carries its unit in its key."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from difflib import get_close_matches
from typing import Any, NoReturn

from drivers.errors import Refused
from drivers.readings import ICE_POINT_K

_UNITS: dict[str, dict[str, float]] = {
    "field": {"T": 1.0, "mT": 1e-3, "uT": 1e-6, "G": 1e-4},
    "current": {"A": 1.0, "mA": 1e-3},
    "voltage": {"V": 1.0},
    "slew": {"A_per_s": 1.0},
    "length": {"m": 1.0, "mm": 1e-3},
    "speed": {"m_per_s": 1.0, "mm_per_s": 1e-3},
    "time": {"s": 1.0, "ms": 1e-3, "min": 60.0},
    "angle": {"rad": 1.0, "deg": math.pi / 180},
    "frequency": {"Hz": 1.0},
    "temperature": {"C": 1.0},
}
_ZEROS = {"temperature": ICE_POINT_K}


class Settings:
    """Settings of one device; each key must be read before `finish`.

    The first fault is raised. Where faults are collected, they are noted instead, and something harmless stands for what cannot be read.

    Attributes:
        location: Key of the device, for messages.
        noted: Faults so far; None where the first is raised.

    Examples:
        >>> settings = Settings({"range_mT": 350, "sensor": "lakeshore_f71"}, "devices.hall")
        >>> settings.quantity("range", "field"), settings.choice("sensor", ("lakeshore_f71", "lakeshore_460"))
        (0.35, 'lakeshore_f71')
        >>> settings.finish()
        >>> faults = []
        >>> settings = Settings({"rang_mT": 350, "rate_Hz": "fast"}, "devices.hall", faults)
        >>> settings.quantity("range", "field"), settings.quantity("rate", "frequency")
        (1.0, 1.0)
        >>> settings.finish()
        >>> [str(fault) for fault in faults]  # doctest: +NORMALIZE_WHITESPACE
        ['devices.hall.range_T must be given once, as range_T or range_mT or range_uT or range_G; received nothing',
         "devices.hall.rate_Hz must hold finite numbers; received 'fast'",
         'devices.hall.rang_mT is not a known key; the closest is range_mT']
    """

    def __init__(self, mapping: object, location: str, noted: list[Refused] | None = None) -> None:
        if not isinstance(mapping, Mapping):
            raise Refused(f"{location} must hold keys and values; received {mapping!r}")
        self.location, self.noted = location, noted
        self._n_before = len(noted or ())
        self._mapping: Mapping[Any, Any] = mapping
        self._unread = list(mapping)
        self._known: set[str] = set()  # keys that were asked for, whether they are there or not

    def __contains__(self, key: str) -> bool:
        self._known.add(key)
        return key in self._mapping

    @property
    def is_sound(self) -> bool:
        """Whether no fault was noted so far."""
        return len(self.noted or ()) == self._n_before

    def noting(self) -> AbstractContextManager[None, bool]:
        """Note a fault that is raised inside and go on behind it, where faults are collected."""
        return noting(self.noted)

    @contextmanager
    def of_this(self) -> Iterator[None]:
        """Say of a fault that is raised inside that it is one of this device; skip nothing else."""
        try:
            yield
        except Refused as fault:
            raise Refused(f"{self.location}: {fault}") from fault

    def judged_by(self, check: Callable[[], object]) -> None:
        """Let a driver judge settings, if they could be read."""
        if self.is_sound:
            with self.noting(), self.of_this():
                check()

    def refuse(self, key: str, rule: str) -> NoReturn:
        """Raise `Refused` with key, rule and value."""
        received = repr(self._mapping[key]) if key in self._mapping else "nothing"
        raise Refused(f"{self.location}.{key} {rule}; received {received}")

    def value(self, key: str) -> Any:
        """The value of a required key."""
        if key not in self:
            self.refuse(key, "must be given")
        self._unread = [unread for unread in self._unread if unread != key]
        return self._mapping[key]

    def text(self, key: str) -> str:
        """A text that is not empty."""
        with self.noting():
            value = self.value(key)
            if not isinstance(value, str) or not value:
                self.refuse(key, "must be a text")
            return value
        return "x"

    def choice(self, key: str, choices: Sequence[str]) -> str:
        """One of `choices`; what else there must be depends on it, so a fault of it is always raised."""
        value = self.value(key)
        if value not in choices:
            close = get_close_matches(str(value), choices, n=1)
            hint = f" (the closest is {close[0]})" if close else ""
            self.refuse(key, f"must be one of {', '.join(choices)}{hint}")
        return str(value)

    def whole_number(self, key: str, default: int | None = None) -> int:
        """A whole number; required unless there is a default."""
        if default is not None and key not in self:
            return default
        with self.noting():
            value = self.value(key)
            if isinstance(value, bool) or not isinstance(value, int):
                self.refuse(key, "must be a whole number")
            return value
        return 1

    def flag(self, key: str) -> bool:
        """True or false; false if not given."""
        if key not in self:
            return False
        with self.noting():
            value = self.value(key)
            if not isinstance(value, bool):
                self.refuse(key, "must be true or false")
            return value
        return False

    def texts(self, key: str) -> dict[str, str]:
        """Texts by name, at least one."""
        with self.noting():
            value = self.value(key)
            if not isinstance(value, Mapping) or not value:
                self.refuse(key, "must hold a text for each name")
            return {str(name): str(text) for name, text in value.items()}
        return {}

    def has_quantity(self, quantity: str, dimension: str) -> bool:
        """Whether the quantity is given, in any unit."""
        return any(f"{quantity}_{unit}" in self for unit in _UNITS[dimension])

    def quantity(self, quantity: str, dimension: str, default: float | None = None) -> float:
        """A quantity in SI; required unless there is a default."""
        if default is not None and not self.has_quantity(quantity, dimension):
            return default
        with self.noting():
            key, factor = self._key(quantity, dimension)
            return _ZEROS.get(dimension, 0.0) + factor * self._number(key, self.value(key))
        return 1.0

    def quantities(self, quantity: str, dimension: str, length: int) -> tuple[float, ...]:
        """A list of `length` numbers with one unit, in SI."""
        with self.noting():
            key, factor = self._key(quantity, dimension)
            values = self.value(key)
            if not isinstance(values, list | tuple) or len(values) != length:
                self.refuse(key, f"must be a list of {length} numbers")
            return tuple(factor * self._number(key, value) for value in values)
        return (1.0,) * length

    def finish(self) -> None:
        """Refuse keys that were not read."""
        for key in map(str, self._unread):
            close = get_close_matches(key, sorted(self._known.difference(map(str, self._mapping))), n=1)
            hint = f"; the closest is {close[0]}" if close else ""
            with self.noting():
                raise Refused(f"{self.location}.{key} is not a known key{hint}")

    def _key(self, quantity: str, dimension: str) -> tuple[str, float]:
        """Key of a quantity and the factor of its unit."""
        factors = {f"{quantity}_{unit}": factor for unit, factor in _UNITS[dimension].items()}
        present = [key for key in factors if key in self]
        if len(present) != 1:
            self.refuse(
                present[1] if present else next(iter(factors)),
                f"must be given once, as {' or '.join(factors)}",
            )
        return present[0], factors[present[0]]

    def _number(self, key: str, value: object) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            self.refuse(key, "must hold finite numbers")
        return float(value)


def noting(noted: list[Refused] | None) -> AbstractContextManager[None, bool]:
    """Note a fault that is raised inside and go on behind it; without a list it is raised."""
    return _Noting(noted)


class _Noting(AbstractContextManager[None, bool]):
    def __init__(self, noted: list[Refused] | None) -> None:
        self._noted = noted

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: object, fault: BaseException | None, traceback: object) -> bool:
        if self._noted is None or not isinstance(fault, Refused):
            return False
        self._noted.append(fault)
        return True
