"""Reads the settings of a device from a mapping of a rig file; every quantity carries its unit in its key."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
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

    Examples:
        >>> settings = Settings({"range_mT": 350, "sensor": "lakeshore_f71"}, "devices.hall")
        >>> settings.quantity("range", "field"), settings.choice("sensor", ("lakeshore_f71", "lakeshore_460"))
        (0.35, 'lakeshore_f71')
        >>> settings.finish()
    """

    def __init__(self, mapping: object, location: str) -> None:
        if not isinstance(mapping, Mapping):
            raise Refused(f"{location} must hold keys and values; received {mapping!r}")
        self.location = location
        self._mapping: Mapping[Any, Any] = mapping
        self._unread = list(mapping)
        self._known: set[str] = set()  # keys that were asked for, whether they are there or not

    def __contains__(self, key: str) -> bool:
        self._known.add(key)
        return key in self._mapping

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
        value = self.value(key)
        if not isinstance(value, str) or not value:
            self.refuse(key, "must be a text")
        return value

    def choice(self, key: str, choices: Sequence[str]) -> str:
        """One of `choices`."""
        value = self.value(key)
        if value not in choices:
            self.refuse(key, f"must be one of {', '.join(choices)}")
        return str(value)

    def whole_number(self, key: str, default: int | None = None) -> int:
        """A whole number; required unless there is a default."""
        if default is not None and key not in self:
            return default
        value = self.value(key)
        if isinstance(value, bool) or not isinstance(value, int):
            self.refuse(key, "must be a whole number")
        return value

    def flag(self, key: str) -> bool:
        """True or false; false if not given."""
        if key not in self:
            return False
        value = self.value(key)
        if not isinstance(value, bool):
            self.refuse(key, "must be true or false")
        return value

    def texts(self, key: str) -> dict[str, str]:
        """Texts by name, at least one."""
        value = self.value(key)
        if not isinstance(value, Mapping) or not value:
            self.refuse(key, "must hold a text for each name")
        return {str(name): str(text) for name, text in value.items()}

    def has_quantity(self, quantity: str, dimension: str) -> bool:
        """Whether the quantity is given, in any unit."""
        return any(f"{quantity}_{unit}" in self for unit in _UNITS[dimension])

    def quantity(self, quantity: str, dimension: str, default: float | None = None) -> float:
        """A quantity in SI; required unless there is a default."""
        if default is not None and not self.has_quantity(quantity, dimension):
            return default
        key, factor = self._key(quantity, dimension)
        return _ZEROS.get(dimension, 0.0) + factor * self._number(key, self.value(key))

    def quantities(self, quantity: str, dimension: str, length: int) -> tuple[float, ...]:
        """A list of `length` numbers with one unit, in SI."""
        key, factor = self._key(quantity, dimension)
        values = self.value(key)
        if not isinstance(values, list | tuple) or len(values) != length:
            self.refuse(key, f"must be a list of {length} numbers")
        return tuple(factor * self._number(key, value) for value in values)

    def finish(self) -> None:
        """Refuse keys that were not read."""
        if self._unread:
            key = str(self._unread[0])
            close = get_close_matches(key, sorted(self._known.difference(map(str, self._mapping))), n=1)
            hint = f"; the closest is {close[0]}" if close else ""
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
