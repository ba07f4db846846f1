"""Mappings as YAML that people read, and numbers of a rig as entries of its file, which are read again bit by bit.

Each is written in the unit of its dimension in which it needs the fewest digits among those in which it survives the round trip.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import yaml

from estimator.rig.parameters import LogNormal, Normal, Parameter, Prior, Uniform
from estimator.rig_files.numbers import MOST_DIGITS, SI_SYMBOL
from estimator.units import UNITS
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


WRITTEN_IN = {"length": ("mm", "m"), "angle": ("deg", "mrad", "rad"), "field": ("uT", "mT", "T")}
LARGEST_WHOLE = 1e15  # beyond that a float does not hold every whole number
KIND: dict[type[Prior], str] = {Normal: "normal", LogNormal: "log_normal", Uniform: "uniform"}


def exact_number(quantity: str, dimension: str, value: float) -> dict[str, Any]:
    """A number without a prior under the key of its quantity and unit."""
    unit = best_unit(dimension, [value])
    return {f"{quantity}_{unit}": in_unit(value, UNITS[unit].to_si)}


def number_of(name: str, dimension: str | None, parameters: Mapping[str, Parameter]) -> dict[str, Any]:
    """One parameter under its key. Pure numbers, and ties with their factors in SI, leave no choice of a unit."""
    parameter, key = parameters[name], name.rpartition(".")[2]
    if dimension is None or parameter.tie is not None:
        return {key: entry_of(parameter)}
    unit = best_unit(dimension, [parameter.value, *_numbers_with_unit(parameter.prior).values()])
    quantity = key.removesuffix(f"_{SI_SYMBOL[dimension]}")
    return {f"{quantity}_{unit}": entry_of(parameter, UNITS[unit].to_si)}


def entry_of(parameter: Parameter, to_si: float = 1.0) -> int | float | Line:
    """Entry of a parameter, in a unit that keeps every number exactly."""
    if parameter.tie is not None:
        factor = {} if parameter.tie.factor == 1.0 else {"factor": _written(parameter.tie.factor)}
        return Line(tied_to=parameter.tie.to, **factor)
    value = in_unit(parameter.value, to_si)
    assert value is not None
    prior = parameter.prior
    if prior is None:
        return value
    numbers = {key: in_unit(number, to_si) for key, number in _numbers_with_unit(prior).items()}
    if isinstance(prior, LogNormal):
        numbers = {"median": numbers.pop("median"), "relative_sd": _written(prior.relative_sd), **numbers}
    if _is_assumed(prior, parameter.is_positive):
        del numbers["lower"]
    entry = Line(prior=Line({KIND[type(prior)]: Line(numbers)}))
    return entry if is_same(parameter.value, prior.centre) else Line(value=value, **entry)


def _numbers_with_unit(prior: Prior | None) -> dict[str, float]:
    """The numbers of a prior in the parameter's unit, by their keys; bounds at infinity are not written."""
    if prior is None:
        return {}
    bounds = {key: end for key in ("lower", "upper") if math.isfinite(end := getattr(prior, key))}
    if isinstance(prior, Normal):
        return {"mean": prior.mean, "sd": prior.standard_deviation, **bounds}
    return {"median": prior.median, **bounds} if isinstance(prior, LogNormal) else bounds


def _is_assumed(prior: Prior, is_positive: bool) -> bool:
    """Whether the reader takes the lower bound for granted."""
    return is_same(prior.lower, 0.0) and (
        isinstance(prior, LogNormal) or (is_positive and isinstance(prior, Normal))
    )


def best_unit(dimension: str, numbers: Sequence[float]) -> str:
    """The unit that needs the fewest digits, of those that convert the numbers from SI and back exactly."""

    def length(unit: str) -> int | float:
        written = [in_unit(number, UNITS[unit].to_si) for number in numbers]
        return math.inf if None in written else sum(len(repr(number)) for number in written)

    return min(WRITTEN_IN[dimension], key=length)


def in_unit(value: float, to_si: float) -> int | float | None:
    """The shortest number that a factor turns into a value, bit by bit; None where there is none.

    Examples:
        >>> in_unit(0.0157, 1e-3), 0.0157 / 1e-3 == 15.7
        (15.7, False)
    """
    value = float(value)  # which a rig made in Python may hold as an int or a number of NumPy
    near = value / to_si
    if not math.isfinite(near):
        return None
    rounded = (float(f"{near:.{digits}g}") for digits in range(1, MOST_DIGITS + 1))
    neighbours = (math.nextafter(near, end) for end in (-math.inf, math.inf))
    return next((_written(n) for n in (*rounded, *neighbours) if is_same(n * to_si, value)), None)


def _written(number: float) -> int | float:
    """A number as short as it can be written: whole ones without a point."""
    number = float(number)
    is_whole = number.is_integer() and abs(number) < LARGEST_WHOLE and not is_same(number, -0.0)
    return int(number) if is_whole else number


def is_same(value: object, expected: object) -> bool:
    """Whether two values are the same to the last bit; 0 and -0 are not."""
    return repr(value) == repr(expected)
