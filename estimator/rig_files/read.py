"""Rig files: YAML to `Rig`, with every mistake named by file, line, key, rule and value."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from estimator.effects import EFFECTS, closest_cause
from estimator.effects.base import Quantity
from estimator.errors import Faults, InvalidInput, closest, in_order, quoted
from estimator.rig.parameters import JointNormal
from estimator.rig.rig import Cause, Rig
from estimator.rig_files.bodies import read_coil, read_mover, read_sensor
from estimator.rig_files.devices import DEVICES, read_devices
from estimator.rig_files.numbers import Numbers, check_ties, read_number
from estimator.units import split_unit
from estimator.yaml_section import Section

SCHEMA_VERSION = 1
JOINT = "joint_prior"
MOST_BODIES = 200  # coils, sensors or movers
# Names become columns of tables, arrays of stores and parts of dotted names.
NAME = re.compile(r"[A-Za-z0-9_-]+")
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


def rig_and_faults(path: Path | str, numbers: Numbers | None = None) -> tuple[Rig | None, list[InvalidInput]]:
    """A rig file with all that is wrong in it, in the order of its lines; `numbers` gets its numbers with their places.

    Returns: The rig, in which NaN stands for each number that could not be read; None where it is not clear what the rig consists of.
        Only without faults may it be used for more than its names.
    """
    faults, numbers = Faults(is_collected=True), numbers or Numbers()
    rig = None
    with faults.noting():
        rig = read_rig(Section.from_file(Path(path), faults), numbers)
    return None if numbers.unclear else rig, in_order(faults.noted)


def read_rig(top: Section, numbers: Numbers | None = None) -> Rig:
    """Read a rig from the top of a file; `numbers` gets them with their places.

    The first fault is raised, or all are noted, as `top.faults` has it.
    """
    numbers = numbers or Numbers()
    noting = top.faults.noting
    with noting():
        version = top.required("schema_version")
        if version != SCHEMA_VERSION:
            top.refuse("schema_version", f"must be {SCHEMA_VERSION}", repr(version))
    name = ""
    with noting():
        name = str(top.required("name"))
    top.value("description")
    sections = {kind: top.section(kind) for kind in ("movers", "coils", "sensors")}
    for kind, bodies in sections.items():
        if (number := len(list(bodies))) > MOST_BODIES:
            top.refuse(kind, f"must name at most {MOST_BODIES}", number)
    movers = tuple(read_mover(below, key, numbers) for key, below in _named(sections["movers"]))
    coils = tuple(read_coil(below, key, movers, numbers) for key, below in _named(sections["coils"]))
    sensors = tuple(read_sensor(below, key, movers, numbers) for key, below in _named(sections["sensors"]))
    for kind in ("coils", "sensors"):
        if not list(sections[kind]):
            fault = InvalidInput.at(top.place(kind), f"{kind} must name at least one; received none")
            sections[kind].faults.note(fault)
    _check_names(sections.values())
    rig = Rig(name, coils, sensors, movers, numbers.parameters)
    rig = replace(
        rig,
        effects=_causes(top.section("effects"), "effects", rig, numbers),
        corrections=_causes(top.section("corrections"), "corrections", rig, numbers),
        devices=read_devices(top.section(DEVICES), rig),
        joint=_joint(top.section(JOINT), rig) if JOINT in top else None,
    )
    top.finish()
    check_ties(numbers)
    _check_values(rig, numbers)
    return rig


def _named(sections: Section) -> Iterator[tuple[str, Section]]:
    for name in sections:
        yield name, sections.section(name)


def _check_values(rig: Rig, numbers: Numbers) -> None:
    """Refuse impossible values: each number once, and none that follows from one that could not be read."""
    refused: set[str] = set()
    clear = replace(rig, coils=tuple(coil for coil in rig.coils if coil.name not in numbers.unclear))
    for parameter, rule, value in clear.broken_rules():
        if parameter in numbers.origin and parameter not in refused and value != str(math.nan):
            refused.add(parameter)
            section, key = numbers.origin[parameter]
            with section.faults.noting():
                section.refuse(key, rule, value)


def _joint(section: Section, rig: Rig) -> JointNormal:
    """A prior of some free parameters together."""
    names, rows = section.required("of"), section.required("covariance")
    section.finish()
    free = [parameter.name for parameter in rig.free]
    if not isinstance(names, list) or not all(name in free and names.count(name) == 1 for name in names):
        rule = f"must list free numbers, each once (free are {', '.join(free)})"
        section.refuse("of", rule, quoted(str(names)))
    try:
        covariance = np.array(rows, dtype=float).reshape(len(names), len(names))
        is_usable = (
            np.array_equal(covariance, covariance.T) and np.isfinite(np.linalg.cholesky(covariance)).all()
        )
    except (TypeError, ValueError, np.linalg.LinAlgError):
        is_usable = False
    if not is_usable:
        rule = f"must be {len(names)} rows of a symmetric, positive definite matrix"
        section.refuse("covariance", rule, quoted(str(rows)))
    return JointNormal(tuple(names), tuple(map(tuple, covariance.tolist())))


def _causes(sections: Section, name: str, rig: Rig, numbers: Numbers) -> tuple[Cause, ...]:
    causes = []
    for label in sections:
        with sections.faults.noting():
            causes.append(_cause(sections.section(label), label, sections, name, rig, numbers))
    return tuple(causes)


def _cause(section: Section, label: str, above: Section, name: str, rig: Rig, numbers: Numbers) -> Cause:
    """One entry `cause[place]` of the section of that name, with its numbers, by their SI keys."""
    match = CAUSE.fullmatch(label)
    if match is None:
        above.refuse(label, "must be written as cause[place], such as axis_gain[hall]", repr(label))
    if match["name"] not in EFFECTS:
        received = f"{quoted(match['name'])}{closest_cause(match['name'])}"
        above.refuse(label, "must be a cause that coilcal knows", received)
    effect = EFFECTS[match["name"]]
    if (belongs := "corrections" if effect.is_correction else "effects") != name:
        above.refuse(label, f"must stand under {belongs}", f"it under {name}")
    places = effect.places(rig)
    if match["place"] not in places and not numbers.unclear:
        rule = f"must name one of {', '.join(places) or 'none in this rig'}"
        above.refuse(label, rule, f"{match['place']!r}{closest(match['place'], places)}")
    quantities = effect.quantities(effect.extent_of(section))
    for quantity in quantities:
        parameter = f"{label}.{quantity.key}"
        numbers.stand_in(parameter, quantity.unit)
        with section.faults.noting():
            if quantity.key not in section:
                _refuse_misspelt(section, quantity, {q.key for q in quantities})
                section.required(quantity.key)
            read_number(section, quantity.key, parameter, quantity.unit, 1.0, numbers, quantity.is_positive)
    section.finish()
    values = {q.key: numbers.parameters[f"{label}.{q.key}"].value for q in quantities}
    broken = None if any(map(math.isnan, values.values())) else effect.broken_rule(values)
    if broken is not None:
        section.refuse(broken[0], broken[1], f"{values[broken[0]]:g}")
    return Cause(effect.name, match["place"])


def _refuse_misspelt(section: Section, quantity: Quantity, known: set[str]) -> None:
    """A quantity that is there without its unit, or in another."""
    stem = quantity.key.removesuffix(f"_{quantity.unit}")
    for key in section:
        if key not in known and (key == stem or split_unit(key)[0] == stem):
            section.refuse(key, f"must be written as {quantity.key}, in SI", repr(section.value(key)))


def _check_names(sections: Iterable[Section]) -> None:
    taken: set[str] = set()
    for section in sections:
        for name in section:
            with section.faults.noting():
                if not NAME.fullmatch(name):
                    section.refuse(name, "must be named by letters, digits, _ and - only", repr(name))
                if name in taken:
                    section.refuse(name, "must have a name of its own", f"{name!r}, which is taken")
            taken.add(name)
