"""`Rig` to YAML: the only writer of rig files, and exact, for `rig_from_text(rig_text(rig)) == rig`.

Every number is written in the unit of its dimension in which it needs the fewest digits among those in which it survives the round trip
bit by bit. What the reader takes for granted (zero poses, unit gains, pitches of twice the wire's radius) is left out.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import astuple
from typing import Any

import yaml

from estimator.rig.arms import ArmEnds, DenavitHartenberg
from estimator.rig.bodies import (
    POSE_QUANTITIES,
    AnyCoil,
    DisplacementFrame,
    EquivalentSourceCoil,
    FieldSum,
    Leads,
    MotionKind,
    Mover,
    Path,
    Sensor,
    SidedCoil,
    UnwoundCoil,
    WoundCoil,
)
from estimator.rig.parameters import LogNormal, Normal, Parameter, Prior, Tie, Uniform
from estimator.rig.rig import Rig
from estimator.rig_files.arm_tables import COLUMNS, ENDS, POSE, key_of_table
from estimator.rig_files.bodies import LEADS, RACETRACK, RECTANGULAR, outline_of
from estimator.rig_files.devices import DEVICES
from estimator.rig_files.harmonic import (
    EQUIVALENT_SOURCES,
    HARMONIC,
    MULTIPOLES,
    OF_THE_BOX,
    amplitude_section,
)
from estimator.rig_files.numbers import MOST_DIGITS, SI_SYMBOL
from estimator.rig_files.read import SCHEMA_VERSION
from estimator.units import UNITS
from estimator.yaml_section import Loader

WRITTEN_IN = {"length": ("mm", "m"), "angle": ("deg", "mrad", "rad"), "field": ("uT", "mT", "T")}
LARGEST_WHOLE = 1e15  # beyond that a float does not hold every whole number
WIDTH = 110
TAG = "tag:yaml.org,2002:"
KIND: dict[type[Prior], str] = {Normal: "normal", LogNormal: "log_normal", Uniform: "uniform"}


def rig_text(rig: Rig, note: str = "") -> str:
    r"""A rig as the text of a rig file.

    Args:
        rig: All of it is written: structure, numbers with priors and ties, effects, corrections, devices.
        note: Comment for the first line.

    Examples:
        >>> from estimator.rig_files.read import rig_from_text
        >>> rig = rig_from_text('''
        ... schema_version: 1
        ... name: small
        ... coils:
        ...   coil1: {radius_cm: 5, wire_radius_mm: 0.98, axial_loops: 12, radial_loops: 3, current_gain: 1.0}
        ... sensors: {hall: {noise_uT: {prior: {normal: {mean: 5, sd: 1}}}}}
        ... ''')
        >>> print(rig_text(rig), end="")
        schema_version: 1
        name: small
        <BLANKLINE>
        coils:
          coil1: {radius_mm: 50, wire_radius_mm: 0.98, axial_loops: 12, radial_loops: 3}
        <BLANKLINE>
        sensors:
          hall:
            noise_uT: {prior: {normal: {mean: 5, sd: 1}}}
        >>> rig_from_text(rig_text(rig)) == rig
        True
    """
    sections: list[dict[str, Any]] = [
        {"schema_version": SCHEMA_VERSION, "name": rig.name},
        {"movers": {mover.name: _mover(mover, rig.parameters) for mover in rig.movers}},
        {"coils": {coil.name: _coil(coil, rig) for coil in rig.coils}},
        {"sensors": {sensor.name: _sensor(sensor, rig) for sensor in rig.sensors}},
        {"effects": {cause.label: _numbers_of_cause(cause.label, rig) for cause in rig.effects}},
        {"corrections": {cause.label: _numbers_of_cause(cause.label, rig) for cause in rig.corrections}},
        {DEVICES: {name: dict(settings) for name, settings in rig.devices.items()}},
    ]
    blocks = [_dumped(section) for section in sections if all(value != {} for value in section.values())]
    return (f"# {note}\n" if note else "") + "\n".join(blocks)


class _Line(dict[str, Any]):
    """A mapping that is written in braces."""


class _Block(dict[str, Any]):
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


def _in_braces(dumper: yaml.SafeDumper, mapping: _Line) -> yaml.MappingNode:
    return dumper.represent_mapping(f"{TAG}map", mapping, flow_style=True)


def _line_by_line(dumper: yaml.SafeDumper, mapping: _Block) -> yaml.MappingNode:
    return dumper.represent_mapping(f"{TAG}map", mapping, flow_style=False)


_Dumper.add_representer(_Line, _in_braces)
_Dumper.add_representer(_Block, _line_by_line)
_Dumper.add_representer(float, _represented)


def _dumped(section: Mapping[str, Any]) -> str:
    text: str = yaml.dump(
        _Block(section),
        Dumper=_Dumper,
        sort_keys=False,
        default_flow_style=None,
        width=WIDTH,
        allow_unicode=True,
    )
    return text


def _own_table(table: DenavitHartenberg, ends: ArmEnds | None) -> _Line:
    line = _Line()
    for (quantity, dimension), column in zip(COLUMNS, astuple(table), strict=True):
        unit = _unit(dimension, list(column))
        line[f"{quantity}_{unit}"] = [_in_unit(value, UNITS[unit].to_si) for value in column]
    for end, pose in zip(ENDS, () if ends is None else astuple(ends), strict=False):
        line[end] = _Line()
        for (quantity, dimension), value in zip(POSE, pose, strict=True):
            line[end] |= _exact(quantity, dimension, value)
    return line


def _exact(quantity: str, dimension: str, value: float) -> dict[str, Any]:
    """A number without a prior under the key of its quantity and unit."""
    unit = _unit(dimension, [value])
    return {f"{quantity}_{unit}": _in_unit(value, UNITS[unit].to_si)}


def _mover(mover: Mover, parameters: Mapping[str, Parameter]) -> dict[str, Any]:
    entry: dict[str, Any] = {"motion": str(mover.motion)}
    key = key_of_table(mover.motion)
    if key is not None and mover.own_table is not None:
        entry[key] = _own_table(mover.own_table, mover.own_ends)
    if mover.motion is not MotionKind.DISPLACEMENT:
        return entry | _pose_block(f"{mover.name}.world_from_base", parameters)
    if mover.displacement_frame is DisplacementFrame.BASE:
        entry["displacement_frame"] = str(mover.displacement_frame)
        entry["base_from_flange0"] = rotation = _Line()
        for axis, angle_rad in zip(("rx", "ry", "rz"), mover.reference_rotation_rad, strict=True):
            rotation |= _exact(axis, "angle", angle_rad)
    return entry


def _coil(coil: AnyCoil, rig: Rig) -> dict[str, Any]:
    if isinstance(coil, UnwoundCoil):
        return _unwound_coil(coil, rig)
    entry = _body(coil.carried_by) | _shape(coil, rig.parameters)
    if f"{coil.name}.wire_radius_m" in rig.parameters:
        entry |= _number(f"{coil.name}.wire_radius_m", "length", rig.parameters)
    for pitch in ("axial_pitch_m", "radial_pitch_m"):
        name = f"{coil.name}.{pitch}"
        tie = Tie(f"{coil.name}.wire_radius_m", 2.0)
        if not _is_same(rig.parameters[name], Parameter(name, "m", 0.0, tie=tie, is_positive=True)):
            entry |= _number(name, "length", rig.parameters)
    for count in ("axial_loops", "radial_loops"):
        entry |= _number(f"{coil.name}.{count}", None, rig.parameters)
    entry |= _gain(f"{coil.name}.current_gain", rig.parameters) | _poses(coil, "coil", rig)
    entry |= _leads(coil.leads)
    if isinstance(coil, SidedCoil):
        return entry
    if coil.field_sum is not FieldSum.VECTORS:
        entry["field_sum"] = str(coil.field_sum)
    return entry | ({"superconducting": True} if coil.is_superconducting else {})


def _leads(leads: Leads | None) -> dict[str, Any]:
    """Paths of the current, each in one unit."""
    entry: dict[str, Any] = {}
    for lead, path in zip(LEADS, () if leads is None else (leads.towards, leads.away), strict=False):
        entry |= _points(lead, path)
    return entry


def _points(quantity: str, points: Path) -> dict[str, Any]:
    """A list of points in one unit; nothing where there are none."""
    unit = _unit("length", [number for point in points for number in point])
    if not points:
        return {}
    return {f"{quantity}_{unit}": [[_in_unit(number, UNITS[unit].to_si) for number in p] for p in points]}


def _shape(coil: WoundCoil, parameters: Mapping[str, Parameter]) -> dict[str, Any]:
    """What a coil's loops are."""
    entry: dict[str, Any] = {}
    if isinstance(coil, SidedCoil):
        entry["model"] = RACETRACK if coil.is_rounded else RECTANGULAR
    for quantity in outline_of(coil):
        entry |= _number(f"{coil.name}.{quantity}_m", "length", parameters)
    return entry


def _unwound_coil(coil: UnwoundCoil, rig: Rig) -> dict[str, Any]:
    entry = _body(coil.carried_by)
    if isinstance(coil, EquivalentSourceCoil):
        entry["model"] = EQUIVALENT_SOURCES
        for quantity, length_m in zip(OF_THE_BOX, (*coil.half_m, coil.margin_m, coil.spacing_m), strict=True):
            entry |= _exact(quantity, "length", length_m)
        entry |= _points(MULTIPOLES, coil.multipoles_m)
    else:
        entry |= {"model": HARMONIC, "region": str(coil.region), "degree": coil.degree}
        entry |= _number(f"{coil.name}.reference_radius_m", "length", rig.parameters)
    entries = {name: _entry(rig.parameters[name]) for names in coil.amplitudes.values() for name in names}
    entry["amplitudes"] = amplitude_section(coil, rig.parameters, entries)
    return entry | _gain(f"{coil.name}.current_gain", rig.parameters) | _poses(coil, "coil", rig)


def _sensor(sensor: Sensor, rig: Rig) -> dict[str, Any]:
    entry = _body(sensor.carried_by) | _number(f"{sensor.name}.noise_T", "field", rig.parameters)
    return entry | _gain(f"{sensor.name}.gain", rig.parameters) | _poses(sensor, "sensor", rig)


def _body(carried_by: str | None) -> dict[str, Any]:
    return {} if carried_by is None else {"carried_by": carried_by}


def _gain(name: str, parameters: Mapping[str, Parameter]) -> dict[str, Any]:
    is_one = _is_same(parameters[name], Parameter(name, "1", 1.0))
    return {} if is_one else _number(name, None, parameters)


def _poses(body: AnyCoil | Sensor, kind: str, rig: Rig) -> dict[str, Any]:
    blocks = (f"world_from_{kind}", f"world_from_{kind}0", f"flange_from_{kind}")
    entries = (_pose_block(f"{body.name}.{block}", rig.parameters) for block in blocks)
    return {block: numbers for entry in entries for block, numbers in entry.items()}


def _pose_block(prefix: str, parameters: Mapping[str, Parameter]) -> dict[str, Any]:
    """A pose without its zeros; nothing where all numbers are zero, or where the body has no such pose."""
    numbers: dict[str, Any] = {}
    for quantity, dimension in POSE_QUANTITIES:
        unit = SI_SYMBOL[dimension]
        name = f"{prefix}.{quantity}_{unit}"
        if name in parameters and not _is_same(parameters[name], Parameter(name, unit, 0.0)):
            numbers |= _number(name, dimension, parameters)
    return {prefix.rpartition(".")[2]: numbers} if numbers else {}


def _numbers_of_cause(label: str, rig: Rig) -> dict[str, Any]:
    """Numbers of an effect, in SI."""
    names = [name for name in rig.parameters if name.startswith(f"{label}.")]
    return {name.removeprefix(f"{label}."): _entry(rig.parameters[name]) for name in names}


def _number(name: str, dimension: str | None, parameters: Mapping[str, Parameter]) -> dict[str, Any]:
    """One parameter under its key. Pure numbers, and ties with their factors in SI, leave no choice of a unit."""
    parameter, key = parameters[name], name.rpartition(".")[2]
    if dimension is None or parameter.tie is not None:
        return {key: _entry(parameter)}
    unit = _unit(dimension, [parameter.value, *_numbers_with_unit(parameter.prior).values()])
    quantity = key.removesuffix(f"_{SI_SYMBOL[dimension]}")
    return {f"{quantity}_{unit}": _entry(parameter, UNITS[unit].to_si)}


def _entry(parameter: Parameter, to_si: float = 1.0) -> int | float | _Line:
    """Entry of a parameter, in a unit that keeps every number exactly."""
    if parameter.tie is not None:
        factor = {} if parameter.tie.factor == 1.0 else {"factor": _written(parameter.tie.factor)}
        return _Line(tied_to=parameter.tie.to, **factor)
    value = _in_unit(parameter.value, to_si)
    assert value is not None
    prior = parameter.prior
    if prior is None:
        return value
    numbers = {key: _in_unit(number, to_si) for key, number in _numbers_with_unit(prior).items()}
    if isinstance(prior, LogNormal):
        numbers = {"median": numbers.pop("median"), "relative_sd": _written(prior.relative_sd), **numbers}
    if _is_assumed(prior, parameter.is_positive):
        del numbers["lower"]
    entry = _Line(prior=_Line({KIND[type(prior)]: _Line(numbers)}))
    return entry if _is_same(parameter.value, prior.centre) else _Line(value=value, **entry)


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
    return _is_same(prior.lower, 0.0) and (
        isinstance(prior, LogNormal) or (is_positive and isinstance(prior, Normal))
    )


def _unit(dimension: str, numbers: Sequence[float]) -> str:
    """The unit that needs the fewest digits, of those that convert the numbers from SI and back exactly."""

    def length(unit: str) -> int | float:
        written = [_in_unit(number, UNITS[unit].to_si) for number in numbers]
        return math.inf if None in written else sum(len(repr(number)) for number in written)

    return min(WRITTEN_IN[dimension], key=length)


def _in_unit(value: float, to_si: float) -> int | float | None:
    """The shortest number that a factor turns into a value, bit by bit; None where there is none.

    Examples:
        >>> _in_unit(0.0157, 1e-3), 0.0157 / 1e-3 == 15.7
        (15.7, False)
    """
    value = float(value)  # which a rig made in Python may hold as an int or a number of NumPy
    near = value / to_si
    if not math.isfinite(near):
        return None
    rounded = (float(f"{near:.{digits}g}") for digits in range(1, MOST_DIGITS + 1))
    neighbours = (math.nextafter(near, end) for end in (-math.inf, math.inf))
    return next((_written(n) for n in (*rounded, *neighbours) if _is_same(n * to_si, value)), None)


def _written(number: float) -> int | float:
    """A number as short as it can be written: whole ones without a point."""
    number = float(number)
    is_whole = number.is_integer() and abs(number) < LARGEST_WHOLE and not _is_same(number, -0.0)
    return int(number) if is_whole else number


def _is_same(value: object, expected: object) -> bool:
    """Whether two values are the same to the last bit; 0 and -0 are not."""
    return repr(value) == repr(expected)
