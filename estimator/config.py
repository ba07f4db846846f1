"""Rig files: YAML to `Rig`, with every mistake named by file, line, key, rule and value."""

from __future__ import annotations

from pathlib import Path

from estimator.errors import InvalidInput
from estimator.parameters import LogNormal, Normal, Parameter, Prior, Tie, Uniform
from estimator.rig import Coil, DisplacementFrame, MotionKind, Mover, Rig, Sensor
from estimator.yaml_section import Section

SCHEMA_VERSION = 1
SI_SYMBOL = {"length": "m", "angle": "rad", "field": "T", "current": "A"}
POSE_QUANTITIES = (
    ("x", "length"),
    ("y", "length"),
    ("z", "length"),
    ("rx", "angle"),
    ("ry", "angle"),
    ("rz", "angle"),
    ("tilt_x", "angle"),
    ("tilt_y", "angle"),
    ("spin", "angle"),
)


def load_rig(path: Path | str) -> Rig:
    """Read a rig file.

    Raises:
        InvalidInput: Unknown key, missing unit, impossible geometry, unknown mover: with file, line, key, rule and value.
    """
    section = Section.from_file(Path(path))
    return _rig(section, Path(path).read_text(encoding="utf-8"))


def rig_from_text(text: str, file: str = "rig") -> Rig:
    """Read a rig from YAML text; `file` names its origin in messages."""
    return _rig(Section.from_text(text, file), text)


def _rig(top: Section, text: str) -> Rig:
    version = top.required("schema_version")
    if version != SCHEMA_VERSION:
        top.refuse("schema_version", f"must be {SCHEMA_VERSION}", repr(version))
    parameters: dict[str, Parameter] = {}
    name = str(top.required("name"))
    top.value("description")
    mover_sections = top.section("movers")
    movers = tuple(_mover(mover_sections.section(key), key, parameters) for key in mover_sections)
    coil_sections = top.section("coils")
    coils = tuple(_coil(coil_sections.section(key), key, movers, parameters) for key in coil_sections)
    sensor_sections = top.section("sensors")
    sensors = tuple(_sensor(sensor_sections.section(key), key, movers, parameters) for key in sensor_sections)
    for kind, number in (("coils", len(coils)), ("sensors", len(sensors))):
        if number == 0:
            raise InvalidInput(f"{kind} must name at least one ({top.file})")
    names = [mover.name for mover in movers] + [body.name for body in (*coils, *sensors)]
    for body_name in names:
        if names.count(body_name) > 1:
            raise InvalidInput(f"the name {body_name!r} must be given to one thing only ({top.file})")
    top.finish()
    rig = Rig(name, coils, sensors, movers, parameters, text)
    _check_ties(rig, top.file)
    _check_geometry(rig, top.file)
    return rig


def _mover(section: Section, name: str, parameters: dict[str, Parameter]) -> Mover:
    motion = MotionKind(section.choice("motion", tuple(MotionKind)))
    frame = DisplacementFrame.END_EFFECTOR
    rotation = [0.0, 0.0, 0.0]
    if motion is MotionKind.DISPLACEMENT:
        frame = DisplacementFrame(
            section.choice("displacement_frame", tuple(DisplacementFrame), default=str(frame))
        )
        if frame is DisplacementFrame.BASE:
            if "base_from_flange0" not in section:
                section.refuse("displacement_frame", "base needs base_from_flange0 (rx, ry, rz)", "none")
            reference = section.section("base_from_flange0")
            for axis, key in enumerate(("rx", "ry", "rz")):
                entry = reference.quantity(key, "angle")
                rotation[axis] = entry[1] if entry else 0.0
            reference.finish()
    else:
        _pose(section.section("world_from_base"), f"{name}.world_from_base", parameters)
    section.finish()
    return Mover(name, motion, frame, (rotation[0], rotation[1], rotation[2]))


def _coil(section: Section, name: str, movers: tuple[Mover, ...], parameters: dict[str, Parameter]) -> Coil:
    _scalar(section, name, "radius", "length", parameters, positive=True)
    for pitch in ("axial_pitch", "radial_pitch"):
        if section.key_with_unit(pitch, "length") is None:
            parameters[f"{name}.{pitch}_m"] = Parameter(
                f"{name}.{pitch}_m", "m", 0.0, tie=Tie(f"{name}.wire_radius_m", 2.0), is_positive=True
            )
        else:
            _scalar(section, name, pitch, "length", parameters, positive=True)
    if section.key_with_unit("wire_radius", "length") is not None or _needs_wire(name, parameters):
        _scalar(section, name, "wire_radius", "length", parameters, positive=True)
    for count in ("axial_loops", "radial_loops"):
        _pure(section, name, count, parameters, positive=True, is_count=True)
    _pure(section, name, "current_gain", parameters, default=1.0)
    carried_by = _body_pose(section, name, "coil", movers, parameters)
    section.finish()
    return Coil(name, carried_by)


def _needs_wire(coil: str, parameters: dict[str, Parameter]) -> bool:
    return any(parameters[f"{coil}.{pitch}_pitch_m"].tie is not None for pitch in ("axial", "radial"))


def _sensor(
    section: Section, name: str, movers: tuple[Mover, ...], parameters: dict[str, Parameter]
) -> Sensor:
    _scalar(section, name, "noise", "field", parameters, positive=True)
    _pure(section, name, "gain", parameters, default=1.0)
    carried_by = _body_pose(section, name, "sensor", movers, parameters)
    section.finish()
    return Sensor(name, carried_by)


def _body_pose(
    section: Section, name: str, kind: str, movers: tuple[Mover, ...], parameters: dict[str, Parameter]
) -> str | None:
    carried_by = section.value("carried_by")
    if carried_by is None:
        blocks = [f"world_from_{kind}"]
    else:
        mover = next((m for m in movers if m.name == carried_by), None)
        if mover is None:
            section.refuse(
                "carried_by",
                f"must name a mover ({', '.join(m.name for m in movers) or 'none given'})",
                repr(carried_by),
            )
        is_relative = mover.motion is MotionKind.DISPLACEMENT
        blocks = [f"world_from_{kind}0", f"flange_from_{kind}"] if is_relative else [f"flange_from_{kind}"]
    for block in blocks:
        _pose(section.section(block), f"{name}.{block}", parameters)
    return None if carried_by is None else str(carried_by)


def _pose(section: Section, prefix: str, parameters: dict[str, Parameter]) -> None:
    for quantity, dimension in POSE_QUANTITIES:
        if section.key_with_unit(quantity, dimension) is None:
            key = f"{prefix}.{quantity}_{SI_SYMBOL[dimension]}"
            parameters[key] = Parameter(key, SI_SYMBOL[dimension], 0.0)
        else:
            _scalar(section, prefix, quantity, dimension, parameters)
    section.finish()


def _scalar(
    section: Section,
    prefix: str,
    quantity: str,
    dimension: str,
    parameters: dict[str, Parameter],
    positive: bool = False,
) -> None:
    entry = section.key_with_unit(quantity, dimension)
    symbol = SI_SYMBOL[dimension]
    if entry is None:
        section.required(f"{quantity}_{symbol}")
        return
    key, unit = entry
    _store(section, key, f"{prefix}.{quantity}_{symbol}", symbol, unit.to_si, parameters, positive)


def _pure(
    section: Section,
    prefix: str,
    key: str,
    parameters: dict[str, Parameter],
    default: float | None = None,
    positive: bool = False,
    is_count: bool = False,
) -> None:
    name = f"{prefix}.{key}"
    if key not in section and default is not None:
        parameters[name] = Parameter(name, "1", default)
        return
    if key not in section:
        section.required(key)
    _store(section, key, name, "1", 1.0, parameters, positive, is_count)


def _store(
    section: Section,
    key: str,
    name: str,
    unit: str,
    to_si: float,
    parameters: dict[str, Parameter],
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
            prior = _prior(spec, to_si) if "prior" in spec else None
            value = spec.number("value") * to_si if prior is None or "value" in spec else prior.centre
        spec.finish()
    else:
        value = section.number(key) * to_si
    if positive and tie is None and value <= 0.0:
        section.refuse(key, "must be > 0", f"{value / to_si:g}")
    if is_count and tie is None and value < 1.0:
        section.refuse(key, "must be at least 1", f"{value:g}")
    if prior is not None and not prior.lower <= value <= prior.upper:
        section.refuse(
            key,
            f"must lie within its prior ({prior.lower / to_si:g} to {prior.upper / to_si:g})",
            f"{value / to_si:g}",
        )
    parameters[name] = Parameter(name, unit, value, prior, tie, positive, is_count)


def _prior(spec: Section, to_si: float) -> Prior:
    block = spec.section("prior")
    kinds = list(block)
    if len(kinds) != 1:
        spec.refuse("prior", "must be one of normal, log_normal, uniform", kinds or "nothing")
    kind = block.choice_of_key(("normal", "log_normal", "uniform"))
    numbers = block.section(kind)
    bounds = {k: numbers.number(k) * to_si for k in ("lower", "upper") if k in numbers}
    try:
        prior: Prior
        if kind == "normal":
            prior = Normal(numbers.number("mean") * to_si, numbers.number("sd") * to_si, **bounds)
        elif kind == "log_normal":
            prior = LogNormal(numbers.number("median") * to_si, numbers.number("relative_sd"), **bounds)
        else:
            prior = Uniform(numbers.number("lower") * to_si, numbers.number("upper") * to_si)
    except InvalidInput as error:
        if spec.file in str(error):
            raise
        spec.refuse("prior", f"breaks a rule: {error}", "the above")
    numbers.finish()
    return prior


def _check_ties(rig: Rig, file: str) -> None:
    for parameter in rig.parameters.values():
        seen = [parameter.name]
        tie = parameter.tie
        while tie is not None:
            if tie.to not in rig.parameters:
                raise InvalidInput(
                    f"{seen[-1]} must be tied to a parameter of the rig; received {tie.to!r} ({file})"
                )
            if tie.to in seen:
                raise InvalidInput(
                    f"{parameter.name} must not be tied in a circle; received {' -> '.join([*seen, tie.to])} ({file})"
                )
            seen.append(tie.to)
            tie = rig.parameters[tie.to].tie


def _check_geometry(rig: Rig, file: str) -> None:
    values = rig.nominal_values()
    for coil in rig.coils:
        radius_m = values[f"{coil.name}.radius_m"]
        thickness_m = values[f"{coil.name}.radial_pitch_m"] * values[f"{coil.name}.radial_loops"]
        if radius_m <= thickness_m:
            raise InvalidInput(
                f"{coil.name}.radius_m must exceed radial_pitch x radial_loops = {thickness_m:.6g} m "
                f"(no bore is left); received {radius_m:.6g} ({file})"
            )
