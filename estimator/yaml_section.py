"""A YAML mapping that knows its file, line and place, and refuses keys that nobody asked for."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NoReturn

import yaml

from estimator.errors import InvalidInput
from estimator.units import UNITS, Unit, split_unit


class Section:
    r"""One mapping of a YAML file; every key must be taken before `finish`.

    Examples:
        >>> section = Section.from_text("radius_mm: 51\n", "rig.yaml")
        >>> section.quantity("radius", "length")
        ('radius_m', 0.051)
        >>> section.finish()
    """

    def __init__(self, node: yaml.MappingNode, path: str, file: str) -> None:
        self.path, self.file, self.line = path, file, node.start_mark.line + 1
        self._entries: dict[str, yaml.Node] = {}
        self._lines: dict[str, int] = {}
        for key_node, value_node in node.value:
            key = str(key_node.value)
            self._lines[key] = key_node.start_mark.line + 1
            if key in self._entries:
                self.refuse(key, "must appear once", "a second one")
            self._entries[key] = value_node
        self._untaken = set(self._entries)

    @classmethod
    def from_text(cls, text: str, file: str) -> Section:
        """The top mapping of a YAML text."""
        try:
            node = yaml.compose(text, Loader=yaml.SafeLoader)
        except yaml.YAMLError as error:
            raise InvalidInput(f"{file} must be YAML; {' '.join(str(error).split())}") from error
        if not isinstance(node, yaml.MappingNode):
            raise InvalidInput(
                f"{file} must hold keys and values; it holds {'nothing' if node is None else 'a list or text'}"
            )
        return cls(node, "", file)

    @classmethod
    def from_file(cls, path: Path) -> Section:
        """The top mapping of a YAML file."""
        try:
            return cls.from_text(path.read_text(encoding="utf-8"), str(path))
        except (OSError, UnicodeDecodeError) as error:
            raise InvalidInput(f"{path} cannot be read: {error}") from error

    def __iter__(self) -> Iterator[str]:
        """All keys, in file order."""
        return iter(self._entries)

    def __contains__(self, key: str) -> bool:
        return key in self._entries

    def place(self, key: str) -> str:
        """Dotted place of a key."""
        return f"{self.path}.{key}" if self.path else key

    def refuse(self, key: str, rule: str, received: object) -> NoReturn:
        """Raise InvalidInput that names place, rule, value, file and line."""
        line = self._lines.get(key, self.line)
        raise InvalidInput(f"{self.place(key)} {rule}; received {received} ({self.file}, line {line})")

    def value(self, key: str, default: Any = None) -> Any:
        """Plain value of a key: text, number, list or None."""
        if key not in self._entries:
            return default
        self._untaken.discard(key)
        return _plain(self._entries[key])

    def required(self, key: str) -> Any:
        """Plain value of a key that must be there."""
        if key not in self._entries:
            raise InvalidInput(f"{self.place(key)} is missing ({self.file}, line {self.line})")
        return self.value(key)

    def number(self, key: str, default: float | None = None) -> float:
        """A finite number; required where there is no default."""
        value = self.required(key) if default is None else self.value(key, default)
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            self.refuse(key, "must be a finite number", repr(value))
        return float(value)

    def choice(self, key: str, choices: tuple[str, ...], default: str | None = None) -> str:
        """One word out of a list."""
        value = self.required(key) if default is None else self.value(key, default)
        if value not in choices:
            self.refuse(key, f"must be one of {', '.join(choices)}", repr(value))
        return str(value)

    def choice_of_key(self, choices: tuple[str, ...]) -> str:
        """The one key of this mapping, out of a list."""
        key = next(iter(self))
        if key not in choices:
            self.refuse(key, f"must be one of {', '.join(choices)}", "it")
        return key

    def section(self, key: str) -> Section:
        """A mapping below this one; empty where the key is absent."""
        self._untaken.discard(key)
        node = self._entries.get(key)
        if node is None:
            node = yaml.MappingNode(
                "tag:yaml.org,2002:map", [], yaml.Mark(self.file, 0, self.line - 1, 0, None, 0)
            )
        if not isinstance(node, yaml.MappingNode):
            self.refuse(key, "must hold keys and values", repr(_plain(node)))
        return Section(node, self.place(key), self.file)

    def is_section(self, key: str) -> bool:
        """Whether the key holds a mapping."""
        return isinstance(self._entries.get(key), yaml.MappingNode)

    def key_with_unit(self, quantity: str, dimension: str) -> tuple[str, Unit] | None:
        """The key that states this quantity, with its unit; None where it is absent.

        Raises:
            InvalidInput: The key has no unit, one of another dimension, or appears with two units.
        """
        symbols = [unit.symbol for unit in UNITS.values() if unit.dimension == dimension]
        found = [key for key in self._entries if split_unit(key)[0] == quantity]
        for key in found:
            unit = split_unit(key)[1]
            if unit is None:
                self.refuse(
                    key,
                    f"lacks its unit: write {' or '.join(f'{quantity}_{s}' for s in symbols)}",
                    _plain(self._entries[key]),
                )
            if unit.dimension != dimension:
                self.refuse(key, f"must be a {dimension} ({', '.join(symbols)})", f"the unit {unit.symbol}")
        if len(found) > 1:
            self.refuse(found[1], "must be given once", f"{' and '.join(found)}")
        if not found:
            return None
        unit = split_unit(found[0])[1]
        assert unit is not None
        return found[0], unit

    def quantity(self, quantity: str, dimension: str) -> tuple[str, float] | None:
        """SI key and SI value of a plain quantity; None where it is absent."""
        entry = self.key_with_unit(quantity, dimension)
        if entry is None:
            return None
        key, unit = entry
        si = next(u.symbol for u in UNITS.values() if u.dimension == dimension)
        return f"{quantity}_{si}", self.number(key) * unit.to_si

    def finish(self) -> None:
        """Refuse keys that nobody took."""
        for key in self._entries:
            if key in self._untaken:
                self.refuse(key, "is not a known key here", "it")


def _plain(node: yaml.Node) -> Any:
    loader = yaml.SafeLoader("")
    try:
        return loader.construct_object(node, deep=True)
    finally:
        loader.dispose()
