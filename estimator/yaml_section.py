"""Read a YAML mapping key by key: typed values, errors with file and line, and refusal of unknown keys."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NoReturn

import yaml

from estimator.errors import Faults, InvalidInput, Place, closest, cut, nearest_name
from estimator.given_files import MOST_SETTINGS_BYTES, read_given_text
from estimator.units import LARGEST, UNITS, Unit, split_unit
from estimator.yaml_loader import Loader

MOST_SHOWN = 200  # characters of a refused value


class Section:
    r"""One mapping of a YAML file; every key must be read before `finish`.

    Examples:
        >>> section = Section.from_text("radius_mm: 51\n", "rig.yaml")
        >>> section.quantity("radius", "length")
        ('radius_m', 0.051)
        >>> section.finish()
    """

    def __init__(self, node: yaml.MappingNode, path: str, file: str, faults: Faults | None = None) -> None:
        self.path, self.file, self.line = path, file, node.start_mark.line + 1
        self.faults = faults or Faults()
        self.folder: Path | None = None  # of a file on disk, whose text may name others
        self._column = node.start_mark.column + 1
        self._entries: dict[str, yaml.Node] = {}
        self._lines: dict[str, int] = {}
        self._columns: dict[str, int] = {}
        self._spans: dict[str, tuple[int, int]] = {}
        for key_node, value_node in node.value:
            line, column = key_node.start_mark.line + 1, key_node.start_mark.column + 1
            place = Place(file, line, column)
            if not isinstance(key_node, yaml.ScalarNode):
                self.faults.note(InvalidInput.at(place, f"{path or 'the file'} must have words as keys"))
                continue
            key = str(key_node.value)
            if key in self._entries:
                words = f"{self.path_of(key)} must be given once; received it in lines {self._lines[key]} and {line} ({file})"
                self.faults.note(InvalidInput(words, place))
                continue
            self._entries[key], self._lines[key], self._columns[key] = value_node, line, column
            self._spans[key] = (key_node.start_mark.index, value_node.end_mark.index)
        self._unread = set(self._entries)
        self._known: dict[str, None] = {}  # keys that were asked for, whether they are there or not

    @classmethod
    def from_text(cls, text: str, file: str, faults: Faults | None = None) -> Section:
        """The top mapping of a YAML text; `faults` says what becomes of the faults in it."""
        if len(text) > MOST_SETTINGS_BYTES:
            raise InvalidInput(f"{file} must hold at most {MOST_SETTINGS_BYTES} bytes; it holds more")
        try:
            loader = Loader(text, file)
            node = loader.get_single_node()
        except yaml.YAMLError as error:
            mark = error.problem_mark if isinstance(error, yaml.MarkedYAMLError) else None
            place = None if mark is None else Place(file, mark.line + 1, mark.column + 1)
            raise InvalidInput(f"{file} must be YAML; {' '.join(str(error).split())}", place) from error
        if not isinstance(node, yaml.MappingNode):
            raise InvalidInput(
                f"{file} must hold keys and values; it holds {'nothing' if node is None else 'a list or text'}"
            )
        return cls(node, "", file, faults)

    @classmethod
    def from_file(cls, path: Path, faults: Faults | None = None) -> Section:
        """The top mapping of a YAML file; `faults` says what becomes of the faults in it."""
        top = cls.from_text(read_given_text(path, MOST_SETTINGS_BYTES), str(path), faults)
        top.folder = path.parent
        return top

    def __iter__(self) -> Iterator[str]:
        """All keys, in file order."""
        return iter(self._entries)

    def __contains__(self, key: str) -> bool:
        self._known[key] = None
        return key in self._entries

    def path_of(self, key: str) -> str:
        """Dotted path of a key, from the top of the file."""
        return f"{self.path}.{key}" if self.path else key

    def refuse(self, key: str, rule: str, received: object) -> NoReturn:
        """Raise InvalidInput that names key, rule, value, file and line; the key counts as read then."""
        self._unread.discard(key)
        words = f"{self.path_of(key)} {rule}; received {cut(str(received), MOST_SHOWN)}"
        raise InvalidInput.at(self.place(key), words)

    def place(self, key: str) -> Place:
        """File, line and column of a key; those of the mapping where it does not have the key."""
        line, column = self._lines.get(key, self.line), self._columns.get(key, self._column)
        return Place(self.file, line, column)

    def span(self, key: str) -> tuple[int, int] | None:
        """Start of a key and end of its value as character indices of the text; None if the key is absent."""
        return self._spans.get(key)

    def value(self, key: str, default: Any = None) -> Any:
        """Plain value of a key: text, number, list or None."""
        if key not in self:
            return default
        self._unread.discard(key)
        try:
            return _plain(self._entries[key])
        except Exception as error:  # a tag such as !!timestamp raises errors of nearly any type on other text
            words = f"{self.path_of(key)} must be plain text, a number or a list"
            raise InvalidInput.at(self.place(key), words) from error

    def required(self, key: str) -> Any:
        """Plain value of a key that must be present."""
        if key not in self:
            self._refuse_missing(key)
        return self.value(key)

    def _refuse_missing(self, key: str) -> NoReturn:
        """Refuse a missing key. The key that was probably meant counts as read, since it is not a second mistake."""
        words = f"{self.path_of(key)} is missing{closest(key, self._unread)}"
        self._unread.discard(nearest_name(key, self._unread) or key)
        raise InvalidInput.at(self.place(key), words)

    def number(self, key: str, default: float | None = None) -> float:
        """A finite number; required unless there is a default."""
        value = self.required(key) if default is None else self.value(key, default)
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            self.refuse(key, "must be a finite number", repr(value))
        if abs(value) > LARGEST:
            self.refuse(key, f"must lie between {-LARGEST:g} and {LARGEST:g}", f"{value:g}")
        return float(value)

    def choice(self, key: str, choices: tuple[str, ...], default: str | None = None) -> str:
        """One word of a list."""
        value = self.required(key) if default is None else self.value(key, default)
        if value not in choices:
            self.refuse(key, f"must be one of {', '.join(choices)}", repr(value))
        return str(value)

    def flag(self, key: str) -> bool:
        """Truth value of a key; false if it is absent."""
        value = self.value(key, False)
        if not isinstance(value, bool):
            self.refuse(key, "must be true or false", value)
        return value

    def key_of(self, choices: tuple[str, ...], section: str) -> str:
        """The only key of the mapping below `section`, which must be one of a list."""
        if section in self and not self.is_section(section):
            self.refuse(section, "must hold keys and values", repr(self.value(section)))
        keys = list(self.section(section))
        if len(keys) != 1 or keys[0] not in choices:
            self.refuse(section, f"must be one of {', '.join(choices)}", " and ".join(keys) or "nothing")
        return keys[0]

    def section(self, key: str) -> Section:
        """A mapping below this one; empty if the key is absent.

        Where faults are collected and the key holds something else, an empty mapping stands in, whose own faults are consequences.
        """
        self._unread.discard(key)
        self._known[key] = None
        node = self._entries.get(key)
        if isinstance(node, yaml.MappingNode):
            return self._below(node, key, self.path_of(key))
        mark = yaml.Mark(self.file, 0, self.line - 1, self._column - 1, None, 0)
        below = self._below(yaml.MappingNode("tag:yaml.org,2002:map", [], mark), key, self.path_of(key))
        if node is not None:
            with self.faults.noting():
                self.refuse(key, "must hold keys and values", repr(self.value(key)))
            below.faults = Faults(is_collected=True)
        return below

    def sections(self, key: str) -> list[Section]:
        """Mappings in a list below this one; none if the key is absent."""
        self._unread.discard(key)
        node = self._entries.get(key)
        if node is None:
            return []
        entries = node.value if isinstance(node, yaml.SequenceNode) else []
        if not entries or not all(isinstance(entry, yaml.MappingNode) for entry in entries):
            self.refuse(key, "must be a list of keys and values", repr(self.value(key)))
        return [self._below(entry, key, f"{self.path_of(key)}[{i}]") for i, entry in enumerate(entries)]

    def _below(self, node: yaml.MappingNode, key: str, path: str) -> Section:
        """A mapping below a key; subclasses make sections of their own kind here."""
        below = Section(node, path, self.file, self.faults)
        below.folder = self.folder
        return below

    def skip(self, *keys: str) -> None:
        """Count keys as read whose content cannot be judged."""
        self._unread.difference_update(keys)

    def is_section(self, key: str) -> bool:
        """Whether the key holds a mapping."""
        return isinstance(self._entries.get(key), yaml.MappingNode)

    def has_quantity(self, quantity: str, dimension: str) -> bool:
        """Whether some key states this quantity, in whatever unit or without one."""
        self._known |= dict.fromkeys(f"{quantity}_{symbol}" for symbol in self.symbols(dimension))
        return bool(self._keys_of(quantity))

    def _keys_of(self, quantity: str) -> list[str]:
        return [key for key in self._entries if key == quantity or key.rpartition("_")[0] == quantity]

    def key_with_unit(self, quantity: str, dimension: str) -> tuple[str, Unit] | None:
        """The key that states this quantity, with its unit; None if it is absent.

        Raises:
            InvalidInput: The key has no unit, one of another dimension, or appears with two units.
        """
        symbols = self.symbols(dimension)
        self._known |= dict.fromkeys(f"{quantity}_{symbol}" for symbol in symbols)
        keys = self._keys_of(quantity)
        for key in keys:
            unit = split_unit(key)[1]
            if unit is None:
                spellings = " or ".join(f"{quantity}_{symbol}" for symbol in symbols)
                self.refuse(key, f"must carry its unit: write {spellings}", repr(self.value(key)))
            if unit.dimension != dimension:
                rule = f"must be in a unit of {dimension} ({', '.join(symbols)})"
                self.refuse(key, rule, f"{self.value(key)!r} in {unit.symbol}")
        if len(keys) > 1:
            self.skip(*keys)
            self.refuse(keys[1], "must be given in one unit", " and ".join(keys))
        if not keys:
            return None
        unit = split_unit(keys[0])[1]
        assert unit is not None
        return keys[0], unit

    @staticmethod
    def symbols(dimension: str) -> list[str]:
        """Units that a quantity of this dimension may be given in; the first is that of SI."""
        return [unit.symbol for unit in UNITS.values() if unit.dimension == dimension]

    def quantity(self, quantity: str, dimension: str) -> tuple[str, float] | None:
        """SI key and SI value of a plain quantity; None if it is absent."""
        entry = self.key_with_unit(quantity, dimension)
        if entry is None:
            return None
        key, key_unit = entry
        return f"{quantity}_{self.symbols(dimension)[0]}", self.number(key) * key_unit.to_si

    def finish(self) -> None:
        """Refuse keys that were not read."""
        known = self._known.keys() - self._entries.keys()
        for key in self._entries:
            if key in self._unread:
                words = f"{self.path_of(key)} is not a known key{closest(key, known)}"
                self.faults.note(InvalidInput.at(self.place(key), words))


def _plain(node: yaml.Node) -> Any:
    loader = Loader("", "")
    try:
        return loader.construct_object(node, deep=True)
    finally:
        loader.dispose()
