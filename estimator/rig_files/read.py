"""Rig files: YAML to `Rig`, with every mistake named by file, line, key, rule and value."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from pathlib import Path

from estimator.effects import EFFECTS
from estimator.effects.base import Quantity
from estimator.errors import InvalidInput
from estimator.rig.parameters import LogNormal, Normal, Parameter, Prior, Tie, Uniform
from estimator.rig.rig import (
    MOST_LOOPS,
    POSE_QUANTITIES,
    Cause,
    Coil,
    DisplacementFrame,
    FieldSum,
    MotionKind,
    Mover,
    Rig,
    Sensor,
)
from estimator.rig_files.devices import DEVICES, read_devices
from estimator.units import split_unit
from estimator.yaml_section import Section

SCHEMA_VERSION = 1
MOST_BODIES = 200  # coils, sensors or movers
NAME = re.compile(
    r"[A-Za-z0-9_-]+"
)  # names become columns of tables, arrays of stores and parts of dotted names
CAUSE = re.compile(r"(?P<name>[a-z_]+)\[(?P<place>[A-Za-z0-9_-]+)\]")
SI_SYMBOL = {"length": "m", "angle": "rad", "field": "T", "current": "A"}


@dataclass
class _Numbers:
    """The numbers of a rig as they are read, with the section and key that each was read from."""

    parameters: dict[str, Parameter] = field(default_factory=dict)
    origin: dict[str, tuple[Section, str]] = field(default_factory=dict)


def load_rig(path: Path | str) -> Rig:
    """Read a rig file.

    Raises:
        InvalidInput: Unknown key, missing unit, impossible geometry, unknown mover: with file, line, key, rule and value.
    """
    return _rig(Section.from_file(Path(path)))


def rig_from_text(text: str, file: str = "rig") -> Rig:
    """Read a rig from YAML text; `file` names its origin in messages."""
    return _rig(Section.from_text(text, file))


def _rig(top: Section) -> Rig:
    version = top.required("schema_version")
    if version != SCHEMA_VERSION:
        top.refuse("schema_version", f"must be {SCHEMA_VERSION}", repr(version))
    numbers = _Numbers()
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
    _check_ties(numbers)
    broken = rig.broken_rule()
    if broken is not None:
        parameter, rule, value = broken
        section, key = numbers.origin[parameter]
        section.refuse(key, rule, value)
    return rig


def _cause(section: Section, label: str, above: Section, name: str, rig: Rig, numbers: _Numbers) -> Cause:
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
        _store(section, quantity.key, parameter, quantity.unit, 1.0, numbers, quantity.is_positive)
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


def _mover(section: Section, name: str, numbers: _Numbers) -> Mover:
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
        _pose(section.section("world_from_base"), f"{name}.world_from_base", numbers)
    section.finish()
    return Mover(name, motion, frame, (rotation[0], rotation[1], rotation[2]))


def _coil(section: Section, name: str, movers: tuple[Mover, ...], numbers: _Numbers) -> Coil:
    _scalar(section, name, "radius", "length", numbers, positive=True)
    follows_wire = {
        pitch: section.key_with_unit(pitch, "length") is None for pitch in ("axial_pitch", "radial_pitch")
    }
    if any(follows_wire.values()) or section.key_with_unit("wire_radius", "length") is not None:
        _scalar(section, name, "wire_radius", "length", numbers, positive=True)
    for pitch, is_tied in follows_wire.items():
        if is_tied:
            numbers.parameters[f"{name}.{pitch}_m"] = Parameter(
                f"{name}.{pitch}_m", "m", 0.0, tie=Tie(f"{name}.wire_radius_m", 2.0), is_positive=True
            )
        else:
            _scalar(section, name, pitch, "length", numbers, positive=True)
    for count in ("axial_loops", "radial_loops"):
        _pure(section, name, count, numbers, positive=True, is_count=True)
    _pure(section, name, "current_gain", numbers, default=1.0)
    carried_by = _body_pose(section, name, "coil", movers, numbers)
    field_sum = section.choice("field_sum", tuple(FieldSum), FieldSum.VECTORS)
    is_superconducting = section.flag("superconducting")
    section.finish()
    return Coil(name, carried_by, FieldSum(field_sum), is_superconducting)


def _sensor(section: Section, name: str, movers: tuple[Mover, ...], numbers: _Numbers) -> Sensor:
    _scalar(section, name, "noise", "field", numbers, positive=True)
    _pure(section, name, "gain", numbers, default=1.0)
    carried_by = _body_pose(section, name, "sensor", movers, numbers)
    section.finish()
    return Sensor(name, carried_by)


def _body_pose(
    section: Section, name: str, kind: str, movers: tuple[Mover, ...], numbers: _Numbers
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
        _pose(section.section(block), f"{name}.{block}", numbers)
    return None if carried_by is None else str(carried_by)


def _pose(section: Section, prefix: str, numbers: _Numbers) -> None:
    for quantity, dimension in POSE_QUANTITIES:
        if section.key_with_unit(quantity, dimension) is None:
            key = f"{prefix}.{quantity}_{SI_SYMBOL[dimension]}"
            numbers.parameters[key] = Parameter(key, SI_SYMBOL[dimension], 0.0)
        else:
            _scalar(section, prefix, quantity, dimension, numbers)
    section.finish()


def _scalar(
    section: Section,
    prefix: str,
    quantity: str,
    dimension: str,
    numbers: _Numbers,
    positive: bool = False,
) -> None:
    entry = section.key_with_unit(quantity, dimension)
    symbol = SI_SYMBOL[dimension]
    if entry is None:
        section.required(f"{quantity}_{symbol}")
        return
    key, unit = entry
    _store(section, key, f"{prefix}.{quantity}_{symbol}", symbol, unit.to_si, numbers, positive)


def _pure(
    section: Section,
    prefix: str,
    key: str,
    numbers: _Numbers,
    default: float | None = None,
    positive: bool = False,
    is_count: bool = False,
) -> None:
    name = f"{prefix}.{key}"
    if key not in section and default is not None:
        numbers.parameters[name] = Parameter(name, "1", default)
        return
    if key not in section:
        section.required(key)
    _store(section, key, name, "1", 1.0, numbers, positive, is_count)


def _store(
    section: Section,
    key: str,
    name: str,
    unit: str,
    to_si: float,
    numbers: _Numbers,
    positive: bool = False,
    is_count: bool = False,
) -> None:
    """Read one number with its prior or tie, in the key's unit, and keep it in SI."""
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
    numbers.parameters[name] = Parameter(name, unit, value, prior, tie, positive, is_count)
    numbers.origin[name] = (section, key)


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
        raise InvalidInput(f"{spec.path_of('prior')}.{error} ({spec.where('prior')})") from None
    return _make_prior(kind, {k: v if k == "relative_sd" else v * to_si for k, v in given.items()})


def _make_prior(kind: str, given: dict[str, float]) -> Prior:
    bounds = {key: given[key] for key in ("lower", "upper") if key in given}
    if kind == "normal":
        return Normal(given["mean"], given["sd"], **bounds)
    if kind == "log_normal":
        return LogNormal(given["median"], given["relative_sd"], **bounds)
    return Uniform(given["lower"], given["upper"])


def _check_ties(numbers: _Numbers) -> None:
    parameters = numbers.parameters
    for name, (section, key) in numbers.origin.items():
        seen, tie = [name], parameters[name].tie
        while tie is not None:
            if tie.to not in parameters:
                section.refuse(key, "must be tied to a parameter of the rig, by its name in SI", repr(tie.to))
            if parameters[tie.to].unit != parameters[name].unit:
                rule = f"must be tied to a parameter in {parameters[name].unit}"
                section.refuse(key, rule, f"{tie.to} in {parameters[tie.to].unit}")
            if tie.to in seen:
                section.refuse(key, "must not be tied in a circle", " -> ".join([*seen, tie.to]))
            seen.append(tie.to)
            tie = parameters[tie.to].tie
