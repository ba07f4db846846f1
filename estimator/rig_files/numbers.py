"""Numbers of a rig file: a value with its prior or tie, in the unit of its key, kept in SI.

A fault ends the reading of one number; where faults are collected, NaN stands in for it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from estimator.errors import InvalidInput, closest
from estimator.rig.bodies import POSE_QUANTITIES
from estimator.rig.parameters import LogNormal, Normal, Parameter, Prior, Tie, Uniform
from estimator.rig.rules import MOST_LOOPS
from estimator.yaml_section import Section

MOST_DIGITS = 17  # tell any two floats apart
SI_SYMBOL = {"length": "m", "angle": "rad", "field": "T", "current": "A"}


@dataclass
class Numbers:
    """The numbers of a rig as they are read, with the section and key that each was read from.

    Attributes:
        parameters: By name.
        origin: Section and key by name, of those that stand in the file and could be read.
        unclear: Movers, coils and sensors that could not be read, so that nobody can say what belongs to them.
    """

    parameters: dict[str, Parameter] = field(default_factory=dict)
    origin: dict[str, tuple[Section, str]] = field(default_factory=dict)
    unclear: set[str] = field(default_factory=set)

    def stand_in(self, name: str, unit: str) -> None:
        """Put NaN where a number is about to be read, in case that it cannot be."""
        self.parameters[name] = Parameter(name, unit, math.nan)


def read_pose(section: Section, prefix: str, numbers: Numbers) -> None:
    """Read the six numbers of a pose; those that are not given are 0."""
    for quantity, dimension in POSE_QUANTITIES:
        if not section.has_quantity(quantity, dimension):
            key = f"{prefix}.{quantity}_{SI_SYMBOL[dimension]}"
            numbers.parameters[key] = Parameter(key, SI_SYMBOL[dimension], 0.0)
        else:
            read_scalar(section, prefix, quantity, dimension, numbers)
    section.finish()


def read_scalar(
    section: Section, prefix: str, quantity: str, dimension: str, numbers: Numbers, positive: bool = False
) -> None:
    """Read a quantity that has a dimension, whose key ends in a unit such as `radius_mm`; it must be given."""
    symbol = SI_SYMBOL[dimension]
    name = f"{prefix}.{quantity}_{symbol}"
    numbers.stand_in(name, symbol)
    with section.faults.noting():
        entry = section.key_with_unit(quantity, dimension)
        if entry is None:
            section.required(f"{quantity}_{symbol}")
            return
        key, unit = entry
        read_number(section, key, name, symbol, unit.to_si, numbers, positive)


def read_pure(
    section: Section,
    prefix: str,
    key: str,
    numbers: Numbers,
    default: float | None = None,
    positive: bool = False,
    is_count: bool = False,
) -> None:
    """Read a pure number; without a default it must be given."""
    name = f"{prefix}.{key}"
    if key not in section and default is not None:
        numbers.parameters[name] = Parameter(name, "1", default)
        return
    numbers.stand_in(name, "1")
    with section.faults.noting():
        if key not in section:
            section.required(key)
        read_number(section, key, name, "1", 1.0, numbers, positive, is_count)


def read_number(
    section: Section,
    key: str,
    name: str,
    unit: str,
    to_si: float,
    numbers: Numbers,
    positive: bool = False,
    is_count: bool = False,
) -> None:
    """Read one number with its prior or tie, in the key's unit, and keep it in SI."""
    numbers.stand_in(name, unit)
    with section.faults.noting():
        numbers.parameters[name] = _number(section, key, name, unit, to_si, positive, is_count)
        numbers.origin[name] = (section, key)


def _number(
    section: Section, key: str, name: str, unit: str, to_si: float, positive: bool, is_count: bool
) -> Parameter:
    prior: Prior | None = None
    tie: Tie | None = None
    if section.is_section(key):
        spec = section.section(key)
        if "tied_to" in spec:
            tie = Tie(str(spec.value("tied_to")), spec.number("factor", 1.0))
            value = 0.0
        else:
            prior = _prior(spec, to_si, positive) if "prior" in spec else None
            value = spec.number("value") * to_si if prior is None or "value" in spec else prior.centre
        spec.finish()
    else:
        value = section.number(key) * to_si
    if positive and tie is None and value <= 0.0:
        section.refuse(key, "must be > 0", f"{value / to_si:g}")
    if is_count and tie is None and value < 1.0:
        section.refuse(key, "must be at least 1", f"{value:g}")
    if is_count and prior is not None and prior.sd > MOST_LOOPS:
        section.refuse(key, f"must have a prior no wider than {MOST_LOOPS}", f"{prior.sd:g}")
    if prior is not None and not prior.lower <= value <= prior.upper:
        section.refuse(
            key,
            f"must lie within its prior ({prior.lower / to_si:g} to {prior.upper / to_si:g})",
            f"{value / to_si:g}",
        )
    return Parameter(name, unit, value, prior, tie, positive, is_count)


def _prior(spec: Section, to_si: float, positive: bool) -> Prior:
    kind = spec.key_of(("normal", "log_normal", "uniform"), "prior")
    block = spec.section("prior").section(kind)
    required = {
        "normal": ("mean", "sd"),
        "log_normal": ("median", "relative_sd"),
        "uniform": ("lower", "upper"),
    }
    given = {key: block.number(key) for key in required[kind]}
    given |= {key: block.number(key) for key in ("lower", "upper") if key in block}
    block.finish()
    if positive and kind == "normal":
        given.setdefault("lower", 0.0)
    for key in ("mean", "lower"):
        if positive and given.get(key, 0.0) < 0.0:
            block.refuse(key, "must be at least 0, as the quantity is positive", f"{given[key]:g}")
    try:
        _make_prior(kind, given)  # in the units of the file, so that a message shows its numbers
    except InvalidInput as error:
        raise InvalidInput.at(spec.place("prior"), f"{spec.path_of('prior')}.{error}") from None
    return _make_prior(kind, {k: v if k == "relative_sd" else v * to_si for k, v in given.items()})


def _make_prior(kind: str, given: dict[str, float]) -> Prior:
    bounds = {key: given[key] for key in ("lower", "upper") if key in given}
    if kind == "normal":
        return Normal(given["mean"], given["sd"], **bounds)
    if kind == "log_normal":
        return LogNormal(given["median"], given["relative_sd"], **bounds)
    return Uniform(given["lower"], given["upper"])


def check_ties(numbers: Numbers) -> None:
    """Refuse a tie to a number that the rig does not have, to one of another unit, or in a circle."""
    for name, (section, _) in numbers.origin.items():
        parameter = numbers.parameters[name]
        if parameter.tie is not None:
            with section.faults.noting():
                _check_tie(numbers, name, parameter.tie)
                continue
            numbers.stand_in(name, parameter.unit)


def _check_tie(numbers: Numbers, name: str, tie: Tie) -> None:
    parameters, (section, key) = numbers.parameters, numbers.origin[name]
    if tie.to.partition(".")[0] in numbers.unclear:
        numbers.stand_in(name, parameters[name].unit)
        return
    if tie.to not in parameters:
        rule = "must be tied to a parameter of the rig, by its name in SI"
        section.refuse(key, rule, f"{tie.to!r}{closest(tie.to, parameters)}")
    if parameters[tie.to].unit != parameters[name].unit:
        rule = f"must be tied to a parameter in {parameters[name].unit}"
        section.refuse(key, rule, f"{tie.to} in {parameters[tie.to].unit}")
    passed, further = [name], tie
    while further.to in parameters and further.to not in passed:
        passed.append(further.to)
        further = parameters[further.to].tie or Tie("")
    if further.to == name:
        section.refuse(key, "must not be tied in a circle", " -> ".join([*passed, name]))
