"""`Rig` to YAML: the only writer of rig files, and exact, for `rig_from_text(rig_text(rig)) == rig`.

What the reader takes for granted (zero poses, unit gains, pitches of twice the wire's radius) is left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import astuple
from typing import Any

from estimator.rig import bodies
from estimator.rig.arms import ArmEnds, DenavitHartenberg
from estimator.rig.parameters import Parameter, Tie
from estimator.rig.rig import Cause, Rig
from estimator.rig_files.arm_tables import COLUMNS, ENDS, key_of_table
from estimator.rig_files.bodies import LEADS, RACETRACK, RECTANGULAR, outline_of
from estimator.rig_files.devices import DEVICES
from estimator.rig_files.dumped import (
    Line,
    best_unit,
    dumped,
    entry_of,
    exact_number,
    in_unit,
    is_same,
    number_of,
)
from estimator.rig_files.harmonic import (
    EQUIVALENT_SOURCES,
    HARMONIC,
    MULTIPOLES,
    OF_THE_BOX,
    amplitude_section,
)
from estimator.rig_files.numbers import SI_SYMBOL
from estimator.rig_files.read import JOINT, SCHEMA_VERSION
from estimator.units import UNITS


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
        {"effects": {cause.label: _numbers_of_cause(cause, rig) for cause in rig.effects}},
        {"corrections": {cause.label: _numbers_of_cause(cause, rig) for cause in rig.corrections}},
        {JOINT: _joint(rig)},
        {DEVICES: {name: dict(settings) for name, settings in rig.devices.items()}},
    ]
    blocks = [dumped(section) for section in sections if all(value != {} for value in section.values())]
    return (f"# {note}\n" if note else "") + "\n".join(blocks)


def _joint(rig: Rig) -> dict[str, Any]:
    joint = rig.joint and rig.joint.among([parameter.name for parameter in rig.free])
    return {"of": list(joint.names), "covariance": [list(row) for row in joint.covariance]} if joint else {}


def _own_table(table: DenavitHartenberg, ends: ArmEnds | None) -> Line:
    line = Line()
    for (quantity, dimension), column in zip(COLUMNS, astuple(table), strict=True):
        unit = best_unit(dimension, list(column))
        line[f"{quantity}_{unit}"] = [in_unit(value, UNITS[unit].to_si) for value in column]
    for end, pose in zip(ENDS, () if ends is None else astuple(ends), strict=False):
        line[end] = Line()
        for (quantity, dimension), value in zip(bodies.CARTESIAN, pose, strict=True):
            line[end] |= exact_number(quantity, dimension, value)
    return line


def _mover(mover: bodies.Mover, parameters: Mapping[str, Parameter]) -> dict[str, Any]:
    entry: dict[str, Any] = {"motion": str(mover.motion)}
    key = key_of_table(mover.motion)
    if key is not None and mover.own_table is not None:
        entry[key] = _own_table(mover.own_table, mover.own_ends)
    if mover.motion is not bodies.MotionKind.DISPLACEMENT:
        return entry | _pose_block(f"{mover.name}.world_from_base", parameters)
    if mover.displacement_frame is bodies.DisplacementFrame.BASE:
        entry["displacement_frame"] = str(mover.displacement_frame)
        entry["base_from_flange0"] = rotation = Line()
        for axis, angle_rad in zip(("rx", "ry", "rz"), mover.reference_rotation_rad, strict=True):
            rotation |= exact_number(axis, "angle", angle_rad)
    return entry


def _coil(coil: bodies.AnyCoil, rig: Rig) -> dict[str, Any]:
    if isinstance(coil, bodies.UnwoundCoil):
        return _unwound_coil(coil, rig)
    entry = _body(coil.carried_by) | _shape(coil, rig.parameters)
    if f"{coil.name}.wire_radius_m" in rig.parameters:
        entry |= number_of(f"{coil.name}.wire_radius_m", "length", rig.parameters)
    for pitch in ("axial_pitch_m", "radial_pitch_m"):
        name = f"{coil.name}.{pitch}"
        tie = Tie(f"{coil.name}.wire_radius_m", 2.0)
        if not is_same(rig.parameters[name], Parameter(name, "m", 0.0, tie=tie, is_positive=True)):
            entry |= number_of(name, "length", rig.parameters)
    for count in ("axial_loops", "radial_loops"):
        entry |= number_of(f"{coil.name}.{count}", None, rig.parameters)
    entry |= _gain(f"{coil.name}.current_gain", rig.parameters) | _poses(coil, "coil", rig)
    entry |= _leads(coil.leads)
    if isinstance(coil, bodies.SidedCoil):
        return entry
    if coil.field_sum is not bodies.FieldSum.VECTORS:
        entry["field_sum"] = str(coil.field_sum)
    return entry | ({"superconducting": True} if coil.is_superconducting else {})


def _leads(leads: bodies.Leads | None) -> dict[str, Any]:
    """Paths of the current, each in one unit."""
    entry: dict[str, Any] = {}
    for lead, path in zip(LEADS, () if leads is None else (leads.towards, leads.away), strict=False):
        entry |= _points(lead, path)
    return entry


def _points(quantity: str, points: bodies.Path) -> dict[str, Any]:
    """A list of points in one unit; nothing where there are none."""
    unit = best_unit("length", [number for point in points for number in point])
    if not points:
        return {}
    return {f"{quantity}_{unit}": [[in_unit(number, UNITS[unit].to_si) for number in p] for p in points]}


def _shape(coil: bodies.WoundCoil, parameters: Mapping[str, Parameter]) -> dict[str, Any]:
    """What a coil's loops are."""
    entry: dict[str, Any] = {}
    if isinstance(coil, bodies.SidedCoil):
        entry["model"] = RACETRACK if coil.is_rounded else RECTANGULAR
    for quantity in outline_of(coil):
        entry |= number_of(f"{coil.name}.{quantity}_m", "length", parameters)
    return entry


def _unwound_coil(coil: bodies.UnwoundCoil, rig: Rig) -> dict[str, Any]:
    entry = _body(coil.carried_by)
    if isinstance(coil, bodies.EquivalentSourceCoil):
        entry["model"] = EQUIVALENT_SOURCES
        for quantity, length_m in zip(OF_THE_BOX, (*coil.half_m, coil.margin_m, coil.spacing_m), strict=True):
            entry |= exact_number(quantity, "length", length_m)
        entry |= _points(MULTIPOLES, coil.multipoles_m)
    else:
        entry |= {"model": HARMONIC, "region": str(coil.region), "degree": coil.degree}
        entry |= number_of(f"{coil.name}.reference_radius_m", "length", rig.parameters)
    entries = {name: entry_of(rig.parameters[name]) for names in coil.amplitudes.values() for name in names}
    entry["amplitudes"] = amplitude_section(coil, rig.parameters, entries)
    return entry | _gain(f"{coil.name}.current_gain", rig.parameters) | _poses(coil, "coil", rig)


def _sensor(sensor: bodies.Sensor, rig: Rig) -> dict[str, Any]:
    entry = _body(sensor.carried_by) | number_of(f"{sensor.name}.noise_T", "field", rig.parameters)
    return entry | _gain(f"{sensor.name}.gain", rig.parameters) | _poses(sensor, "sensor", rig)


def _body(carried_by: str | None) -> dict[str, Any]:
    return {} if carried_by is None else {"carried_by": carried_by}


def _gain(name: str, parameters: Mapping[str, Parameter]) -> dict[str, Any]:
    is_one = is_same(parameters[name], Parameter(name, "1", 1.0))
    return {} if is_one else number_of(name, None, parameters)


def _poses(body: bodies.AnyCoil | bodies.Sensor, kind: str, rig: Rig) -> dict[str, Any]:
    blocks = (f"world_from_{kind}", f"world_from_{kind}0", f"flange_from_{kind}")
    entries = (_pose_block(f"{body.name}.{block}", rig.parameters) for block in blocks)
    return {block: numbers for entry in entries for block, numbers in entry.items()}


def _pose_block(prefix: str, parameters: Mapping[str, Parameter]) -> dict[str, Any]:
    """A pose without its zeros; nothing where all numbers are zero, or where the body has no such pose."""
    numbers: dict[str, Any] = {}
    for quantity, dimension in bodies.POSE_QUANTITIES:
        unit = SI_SYMBOL[dimension]
        name = f"{prefix}.{quantity}_{unit}"
        if name in parameters and not is_same(parameters[name], Parameter(name, unit, 0.0)):
            numbers |= number_of(name, dimension, parameters)
    return {prefix.rpartition(".")[2]: numbers} if numbers else {}


def _numbers_of_cause(cause: Cause, rig: Rig) -> dict[str, Any]:
    """Numbers of an effect, in SI."""
    return {key: entry_of(rig.parameters[name]) for key, name in rig.names_of(cause).items()}
