"""Rig files: YAML to `Rig`, with every mistake named by file, line, key, rule and value."""

from __future__ import annotations

import re
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path

from estimator.effects import EFFECTS
from estimator.effects.base import Quantity
from estimator.errors import InvalidInput
from estimator.rig.parameters import Parameter, Tie
from estimator.rig.rig import (
    AnyCoil,
    Cause,
    Coil,
    DisplacementFrame,
    FieldSum,
    HarmonicCoil,
    MotionKind,
    Mover,
    Rig,
    Sensor,
)
from estimator.rig_files.devices import DEVICES, read_devices
from estimator.rig_files.harmonic import MODEL, read_harmonic, read_region
from estimator.rig_files.numbers import Numbers, check_ties, read_number, read_pose, read_pure, read_scalar
from estimator.units import split_unit
from estimator.yaml_section import Section

SCHEMA_VERSION = 1
MOST_BODIES = 200  # coils, sensors or movers
NAME = re.compile(
    r"[A-Za-z0-9_-]+"
)  # names become columns of tables, arrays of stores and parts of dotted names
WINDING = "winding"  # the model of a coil that names none
OF_A_WINDING = (
    "radius",
    "wire_radius",
    "axial_pitch",
    "radial_pitch",
    "axial_loops",
    "radial_loops",
    "field_sum",
    "superconducting",
)
CAUSE = re.compile(r"(?P<name>[a-z_]+)\[(?P<place>[A-Za-z0-9_-]+)\]")


def load_rig(path: Path | str) -> Rig:
    """Read a rig file.

    Raises:
        InvalidInput: Unknown key, missing unit, impossible geometry, unknown mover: with file, line, key, rule and value.
    """
    return read_rig(Section.from_file(Path(path)))


def rig_from_text(text: str, file: str = "rig") -> Rig:
    """Read a rig from YAML text; `file` names its origin in messages."""
    return read_rig(Section.from_text(text, file))


def read_rig(top: Section) -> Rig:
    """Read a rig from the top of a file."""
    version = top.required("schema_version")
    if version != SCHEMA_VERSION:
        top.refuse("schema_version", f"must be {SCHEMA_VERSION}", repr(version))
    numbers = Numbers()
    name = str(top.required("name"))
    top.value("description")
    for kind in ("movers", "coils", "sensors"):
        if len(list(top.section(kind))) > MOST_BODIES:
            top.refuse(kind, f"must name at most {MOST_BODIES}", len(list(top.section(kind))))
    mover_sections = top.section("movers")
    movers = tuple(_mover(mover_sections.section(key), key, numbers) for key in mover_sections)
    coil_sections = top.section("coils")
    coils = tuple(_coil(coil_sections.section(key), key, movers, numbers) for key in coil_sections)
    sensor_sections = top.section("sensors")
    sensors = tuple(_sensor(sensor_sections.section(key), key, movers, numbers) for key in sensor_sections)
    for kind, number in (("coils", len(coils)), ("sensors", len(sensors))):
        if number == 0:
            raise InvalidInput(f"{kind} must name at least one; received none ({top.where(kind)})")
    _check_names((mover_sections, coil_sections, sensor_sections))
    rig = Rig(name, coils, sensors, movers, numbers.parameters)
    acting = [
        tuple(_cause(sections.section(label), label, sections, name, rig, numbers) for label in sections)
        for name in ("effects", "corrections")
        for sections in (top.section(name),)
    ]
    rig = replace(
        rig, effects=acting[0], corrections=acting[1], devices=read_devices(top.section(DEVICES), rig)
    )
    top.finish()
    check_ties(numbers)
    broken = rig.broken_rule()
    if broken is not None:
        parameter, rule, value = broken
        section, key = numbers.origin[parameter]
        section.refuse(key, rule, value)
    return rig


def _cause(section: Section, label: str, above: Section, name: str, rig: Rig, numbers: Numbers) -> Cause:
    """One entry `cause[place]` of the section of that name, with its numbers, by their SI keys."""
    match = CAUSE.fullmatch(label)
    if match is None:
        above.refuse(label, "must be written as cause[place], such as axis_gain[hall]", repr(label))
    if match["name"] not in EFFECTS:
        closest = " ".join(get_close_matches(match["name"], EFFECTS, n=1, cutoff=0.0))
        above.refuse(label, f"must be a cause that coilcal knows, such as {closest}", repr(match["name"]))
    effect = EFFECTS[match["name"]]
    if (belongs := "corrections" if effect.is_correction else "effects") != name:
        above.refuse(label, f"must stand under {belongs}", f"it under {name}")
    places = effect.places(rig)
    if match["place"] not in places:
        above.refuse(
            label, f"must name one of {', '.join(places) or 'none in this rig'}", repr(match["place"])
        )
    quantities = effect.quantities(effect.extent_of(section))
    for quantity in quantities:
        if quantity.key not in section:
            _refuse_misspelt(section, quantity, {q.key for q in quantities})
            section.required(quantity.key)
        parameter = f"{label}.{quantity.key}"
        read_number(section, quantity.key, parameter, quantity.unit, 1.0, numbers, quantity.is_positive)
    section.finish()
    values = {q.key: numbers.parameters[f"{label}.{q.key}"].value for q in quantities}
    broken = effect.broken_rule(values)
    if broken is not None:
        section.refuse(broken[0], broken[1], f"{values[broken[0]]:g}")
    return Cause(effect.name, match["place"])


def _refuse_misspelt(section: Section, quantity: Quantity, known: set[str]) -> None:
    """A quantity that is there without its unit, or in another."""
    stem = quantity.key.removesuffix(f"_{quantity.unit}")
    for key in section:
        if key not in known and (key == stem or split_unit(key)[0] == stem):
            section.refuse(key, f"must be written as {quantity.key}, in SI", repr(section.value(key)))


def _check_names(sections: tuple[Section, ...]) -> None:
    taken: set[str] = set()
    for section in sections:
        for name in section:
            if not NAME.fullmatch(name):
                section.refuse(name, "must be named by letters, digits, _ and - only", repr(name))
            if name in taken:
                section.refuse(name, "must have a name of its own", f"{name!r}, which is taken")
            taken.add(name)


def _mover(section: Section, name: str, numbers: Numbers) -> Mover:
    motion = MotionKind(section.choice("motion", tuple(MotionKind)))
    frame = DisplacementFrame.END_EFFECTOR
    rotation = [0.0, 0.0, 0.0]
    if motion is MotionKind.DISPLACEMENT:
        frame = DisplacementFrame(
            section.choice("displacement_frame", tuple(DisplacementFrame), default=str(frame))
        )
        if frame is DisplacementFrame.BASE:
            if "base_from_flange0" not in section:
                section.refuse(
                    "displacement_frame", "base needs the rotation base_from_flange0 {rx, ry, rz}", "none"
                )
            reference = section.section("base_from_flange0")
            for axis, key in enumerate(("rx", "ry", "rz")):
                entry = reference.quantity(key, "angle")
                rotation[axis] = entry[1] if entry else 0.0
            reference.finish()
    else:
        read_pose(section.section("world_from_base"), f"{name}.world_from_base", numbers)
    section.finish()
    return Mover(name, motion, frame, (rotation[0], rotation[1], rotation[2]))


def _coil(section: Section, name: str, movers: tuple[Mover, ...], numbers: Numbers) -> AnyCoil:
    if section.choice("model", (WINDING, MODEL), WINDING) == MODEL:
        return _harmonic_coil(section, name, movers, numbers)
    read_scalar(section, name, "radius", "length", numbers, positive=True)
    follows_wire = {
        pitch: section.key_with_unit(pitch, "length") is None for pitch in ("axial_pitch", "radial_pitch")
    }
    if any(follows_wire.values()) or section.key_with_unit("wire_radius", "length") is not None:
        read_scalar(section, name, "wire_radius", "length", numbers, positive=True)
    for pitch, is_tied in follows_wire.items():
        if is_tied:
            numbers.parameters[f"{name}.{pitch}_m"] = Parameter(
                f"{name}.{pitch}_m", "m", 0.0, tie=Tie(f"{name}.wire_radius_m", 2.0), is_positive=True
            )
        else:
            read_scalar(section, name, pitch, "length", numbers, positive=True)
    for count in ("axial_loops", "radial_loops"):
        read_pure(section, name, count, numbers, positive=True, is_count=True)
    read_pure(section, name, "current_gain", numbers, default=1.0)
    carried_by = _body_pose(section, name, "coil", movers, numbers)
    field_sum = section.choice("field_sum", tuple(FieldSum), FieldSum.VECTORS)
    is_superconducting = section.flag("superconducting")
    section.finish()
    return Coil(name, carried_by, FieldSum(field_sum), is_superconducting)


def _harmonic_coil(section: Section, name: str, movers: tuple[Mover, ...], numbers: Numbers) -> HarmonicCoil:
    region, degree = read_region(section)
    coil = HarmonicCoil(name, None, region, degree)
    read_harmonic(section, coil, numbers)
    read_pure(section, name, "current_gain", numbers, default=1.0)
    carried_by = _body_pose(section, name, "coil", movers, numbers)
    for key in OF_A_WINDING:
        if any(given == key or split_unit(given)[0] == key for given in section):
            given = next(g for g in section if g == key or split_unit(g)[0] == key)
            section.refuse(
                given, f"must not be given for a coil of model {MODEL}, which has no winding", given
            )
    section.finish()
    return replace(coil, carried_by=carried_by)


def _sensor(section: Section, name: str, movers: tuple[Mover, ...], numbers: Numbers) -> Sensor:
    read_scalar(section, name, "noise", "field", numbers, positive=True)
    read_pure(section, name, "gain", numbers, default=1.0)
    carried_by = _body_pose(section, name, "sensor", movers, numbers)
    section.finish()
    return Sensor(name, carried_by)


def _body_pose(
    section: Section, name: str, kind: str, movers: tuple[Mover, ...], numbers: Numbers
) -> str | None:
    carried_by = section.value("carried_by")
    if carried_by is None:
        blocks = [f"world_from_{kind}"]
    else:
        mover = next((m for m in movers if m.name == carried_by), None)
        if mover is None:
            section.refuse(
                "carried_by",
                f"must name a mover ({', '.join(m.name for m in movers) or 'the rig has none'})",
                repr(carried_by),
            )
        is_relative = mover.motion is MotionKind.DISPLACEMENT
        blocks = [f"world_from_{kind}0", f"flange_from_{kind}"] if is_relative else [f"flange_from_{kind}"]
    for block in blocks:
        read_pose(section.section(block), f"{name}.{block}", numbers)
    return None if carried_by is None else str(carried_by)
