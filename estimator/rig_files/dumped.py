"""Mappings as YAML that people read: entries of few numbers in one line, and floats to the last digit."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import yaml

from estimator.yaml_loader import Loader

WIDTH = 110
TAG = "tag:yaml.org,2002:"


class Line(dict[str, Any]):
    """A mapping that is written in braces."""


class Block(dict[str, Any]):
    """A mapping with a line for each key, though all its values are plain."""


class _Dumper(yaml.SafeDumper):
    """Quotes what a reader of YAML would take for something other than text."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


_Dumper.yaml_implicit_resolvers = {
    first: [*yaml.SafeDumper.yaml_implicit_resolvers.get(first, []), *Loader.yaml_implicit_resolvers.get(first, [])]
    for first in {**yaml.SafeDumper.yaml_implicit_resolvers, **Loader.yaml_implicit_resolvers}
}  # fmt: skip


def _represented(dumper: yaml.SafeDumper, number: float) -> yaml.ScalarNode:
    """A float to the last digit, as YAML 1.2 writes it: 2e-05, where YAML 1.1 asks for 2.0e-05."""
    if not math.isfinite(number):
        return dumper.represent_float(number)
    return dumper.represent_scalar(f"{TAG}float", repr(number))


def _in_braces(dumper: yaml.SafeDumper, mapping: Line) -> yaml.MappingNode:
    return dumper.represent_mapping(f"{TAG}map", mapping, flow_style=True)


def _line_by_line(dumper: yaml.SafeDumper, mapping: Block) -> yaml.MappingNode:
    return dumper.represent_mapping(f"{TAG}map", mapping, flow_style=False)


_Dumper.add_representer(Line, _in_braces)
_Dumper.add_representer(Block, _line_by_line)
_Dumper.add_representer(float, _represented)


def dumped(section: Mapping[str, Any]) -> str:
    """Text of a section, in which every key of the mapping has a line."""
    return yaml.dump(
        Block(section),
        Dumper=_Dumper,
        sort_keys=False,
        default_flow_style=None,
        width=WIDTH,
        allow_unicode=True,
    )
