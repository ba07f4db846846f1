"""YAML as rig files and plans are written: numbers as in YAML 1.2, and limits on what a text may hold."""

from __future__ import annotations

import re
from typing import NoReturn

import yaml

from estimator.errors import InvalidInput, Place

# Far beyond any rig or plan. The text of a file may come from anywhere, and YAML's short forms can stand for endless data.
MOST_VALUES = 100_000
MOST_LEVELS = 20
HALF = re.compile(r"[\ud800-\udfff]")  # of a character, which no file can hold


class Loader(yaml.SafeLoader):
    """Numbers as in YAML 1.2: 2e-5 is a number and 010 is ten; 1:30, 1_000 and 2025-01-31 are text.

    Keys, values and levels are counted while they are read, those behind an alias (`*noise`) as often as it is used.
    """

    def __init__(self, text: str, file: str) -> None:
        super().__init__(text)
        self.name = file
        self._n_values = self._level = 0
        self._n_behind: dict[str, int] = {}

    def compose_node(self, parent: yaml.Node | None, index: int | yaml.Node | None) -> yaml.Node | None:
        """Compose a value with all that it holds; refuse one beyond the limits."""
        event, n_before = self.peek_event(), self._n_values  # type: ignore[no-untyped-call]
        is_alias = isinstance(event, yaml.AliasEvent)
        if is_alias and event.anchor in self.anchors and event.anchor not in self._n_behind:
            self._refuse(f"must not hold itself; *{event.anchor} does")
        self._n_values += self._n_behind.get(event.anchor, 1) if is_alias else 1
        self._level += 1
        if self._n_values > MOST_VALUES:
            self._refuse(f"must hold at most {MOST_VALUES} keys and values; there are more")
        if isinstance(event, yaml.ScalarEvent) and HALF.search(event.value):
            self._refuse("must hold whole characters; there is half a one")
        if self._level > MOST_LEVELS:
            self._refuse(f"must have at most {MOST_LEVELS} levels; there are more")
        node: yaml.Node | None = super().compose_node(parent, index)  # type: ignore[arg-type]  # the top has no index
        self._level -= 1
        if event.anchor is not None and not is_alias:
            self._n_behind[event.anchor] = self._n_values - n_before
        return node

    def _refuse(self, rule: str) -> NoReturn:
        place = Place(self.name, self.line + 1, self.column + 1)
        raise InvalidInput(f"{self.name} {rule} (line {place.line})", place)


_INT, _FLOAT, _TIMESTAMP = (f"tag:yaml.org,2002:{kind}" for kind in ("int", "float", "timestamp"))
Loader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers if tag not in (_INT, _FLOAT, _TIMESTAMP)]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
Loader.add_implicit_resolver(_INT, re.compile(r"[-+]?[0-9]+$"), list("-+0123456789"))
Loader.add_implicit_resolver(
    _FLOAT,
    re.compile(
        r"([-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN))$"
    ),
    list("-+.0123456789"),
)
# Python makes no float of longer whole numbers, and none at all of thousands of digits; as a float they are infinite, and refused as such.
Loader.add_constructor(_INT, lambda _, node: int(node.value) if len(node.value) <= 300 else float(node.value))
