"""Movers, coils and sensors of a rig file.

A body that cannot be read is named in `Numbers.unclear` where faults are collected, and one of its name stands in for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from estimator.errors import closest
from estimator.rig.bodies import (
    AnyCoil,
    Coil,
    DisplacementFrame,
    FieldSum,
    HarmonicCoil,
    Leads,
    MotionKind,
    Mover,
    Sensor,
    SidedCoil,
    UnwoundCoil,
    WoundCoil,
)
from estimator.rig.parameters import Parameter, Tie
from estimator.rig_files.arm_tables import read_own_table, read_points
from estimator.rig_files.harmonic import (
    EQUIVALENT_SOURCES,
    HARMONIC,
    read_amplitudes,
    read_box,
    read_harmonic,
    read_region,
)
from estimator.rig_files.numbers import Numbers, read_pose, read_pure, read_scalar
from estimator.units import split_unit
from estimator.yaml_section import Section

WINDING = "winding"  # the model of a coil that names none
RECTANGULAR, RACETRACK = "rectangular", "racetrack"  # windings with straight sides
OF_LOOPS = ("wire_radius", "axial_pitch", "radial_pitch", "axial_loops", "radial_loops")
OF_A_ROUND_WINDING = ("radius", "field_sum", "superconducting")
LEADS = ("lead_in", "lead_out")  # in the order in which the current passes them
SIDES, CORNER = ("inner_side_x", "inner_side_y"), "inner_corner_radius"
OF_A_WINDING = (*OF_A_ROUND_WINDING, *OF_LOOPS, *SIDES, CORNER, *LEADS)
WRONG_PLACE: dict[str, tuple[tuple[str, ...], str]] = {  # by model what it may not have, and why
    HARMONIC: (OF_A_WINDING, "which has no winding"),
    EQUIVALENT_SOURCES: (OF_A_WINDING, "which has no winding"),
    RECTANGULAR: ((*OF_A_ROUND_WINDING, CORNER), "which has straight sides and sharp corners"),
    RACETRACK: (OF_A_ROUND_WINDING, "which has straight sides"),
    WINDING: ((*SIDES, CORNER), "whose loops are circles"),
}


def outline_of(coil: WoundCoil) -> tuple[str, ...]:
    """Quantities that say how large a winding is, beside those of its loops."""
    if isinstance(coil, Coil):
        return ("radius",)
    return (*SIDES, CORNER) if coil.is_rounded else SIDES


def read_mover(section: Section, name: str, numbers: Numbers) -> Mover:
    """Read a mover."""
    numbers.unclear.add(name)
    with section.faults.noting():
        mover = _clear_mover(section, name, numbers)
        numbers.unclear.remove(name)
        return mover
    return Mover(name, MotionKind.POSE)


def _clear_mover(section: Section, name: str, numbers: Numbers) -> Mover:
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
    own_table, own_ends = read_own_table(section, motion)
    section.finish()
    return Mover(name, motion, frame, (rotation[0], rotation[1], rotation[2]), own_table, own_ends)


def read_coil(section: Section, name: str, movers: tuple[Mover, ...], numbers: Numbers) -> AnyCoil:
    """Read a coil with its winding of whatever shape, or one without."""
    numbers.unclear.add(name)
    with section.faults.noting():
        coil = _clear_coil(section, name, movers, numbers)
        numbers.unclear.remove(name)
        return coil
    return Coil(name)


def _clear_coil(section: Section, name: str, movers: tuple[Mover, ...], numbers: Numbers) -> AnyCoil:
    model = section.choice("model", (WINDING, RECTANGULAR, RACETRACK, HARMONIC, EQUIVALENT_SOURCES), WINDING)
    _refuse_of_others(section, model)
    if model in (HARMONIC, EQUIVALENT_SOURCES):
        return _unwound_coil(section, name, model, movers, numbers)
    coil: WoundCoil = Coil(name) if model == WINDING else SidedCoil(name, None, model == RACETRACK)
    for quantity in outline_of(coil):
        read_scalar(section, name, quantity, "length", numbers, positive=True)
    _read_loops(section, name, numbers)
    carried_by = _body_pose(section, name, "coil", movers, numbers)
    if isinstance(coil, Coil):
        with section.faults.noting():
            field_sum = FieldSum(section.choice("field_sum", tuple(FieldSum), FieldSum.VECTORS))
            coil = replace(coil, field_sum=field_sum)
        with section.faults.noting():
            coil = replace(coil, is_superconducting=section.flag("superconducting"))
    leads = _read_leads(section)
    section.finish()
    return replace(coil, carried_by=carried_by, leads=leads)


def _read_leads(section: Section) -> Leads | None:
    rule = "must be a list of two points or more, each of three numbers"
    paths = [tuple(read_points(section, lead, rule, 2)[1]) for lead in LEADS]
    return Leads(*paths) if any(paths) else None


def _refuse_of_others(section: Section, model: str) -> None:
    """Refuse what only coils of another model have."""
    keys, why = WRONG_PLACE[model]
    for given in section:
        if (given if given in keys else split_unit(given)[0]) in keys:
            section.refuse(given, f"must not be given for a coil of model {model}, {why}", given)


def _read_loops(section: Section, name: str, numbers: Numbers) -> None:
    """Read how wires lie beside each other and how many they are, and the current gain."""
    follows_wire = {
        pitch: not section.has_quantity(pitch, "length") for pitch in ("axial_pitch", "radial_pitch")
    }
    if any(follows_wire.values()) or section.has_quantity("wire_radius", "length"):
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


def _unwound_coil(
    section: Section, name: str, model: str, movers: tuple[Mover, ...], numbers: Numbers
) -> UnwoundCoil:
    coil: UnwoundCoil
    if model == HARMONIC:
        coil = HarmonicCoil(name, None, *read_region(section))
        read_harmonic(section, coil, numbers)
    else:
        coil = read_box(section, name)
        read_amplitudes(section, coil, numbers)
    read_pure(section, name, "current_gain", numbers, default=1.0)
    carried_by = _body_pose(section, name, "coil", movers, numbers)
    section.finish()
    return replace(coil, carried_by=carried_by)


def read_sensor(section: Section, name: str, movers: tuple[Mover, ...], numbers: Numbers) -> Sensor:
    """Read a sensor."""
    read_scalar(section, name, "noise", "field", numbers, positive=True)
    read_pure(section, name, "gain", numbers, default=1.0)
    carried_by = _body_pose(section, name, "sensor", movers, numbers)
    section.finish()
    return Sensor(name, carried_by)


def _body_pose(
    section: Section, name: str, kind: str, movers: tuple[Mover, ...], numbers: Numbers
) -> str | None:
    carried_by = section.value("carried_by")
    mover = next((m for m in movers if m.name == carried_by), None)
    if carried_by is None:
        blocks = [f"world_from_{kind}"]
    elif mover is None or mover.name in numbers.unclear:
        blocks = [
            b for b in (f"world_from_{kind}", f"world_from_{kind}0", f"flange_from_{kind}") if b in section
        ]
    elif mover.motion is MotionKind.DISPLACEMENT:
        blocks = [f"world_from_{kind}0", f"flange_from_{kind}"]
    else:
        blocks = [f"flange_from_{kind}"]
    with section.faults.noting():
        if carried_by is not None and mover is None:
            names = ", ".join(m.name for m in movers) or "the rig has none"
            hint = closest(str(carried_by), [m.name for m in movers])
            section.refuse("carried_by", f"must name a mover ({names})", f"{carried_by!r}{hint}")
    _refuse_other_poses(section, kind, mover, blocks)
    for block in blocks:
        read_pose(section.section(block), f"{name}.{block}", numbers)
    return None if mover is None else mover.name


def _refuse_other_poses(section: Section, kind: str, mover: Mover | None, blocks: Sequence[str]) -> None:
    """Refuse the pose of a body that is carried in another way, and say which pose this one has."""
    if mover is None:
        why = f"world_from_{kind} for a {kind} that stands still; only one that is carried_by a mover has another pose"
    elif mover.motion is MotionKind.DISPLACEMENT:
        why = (
            f"world_from_{kind}0 for a {kind} that {mover.name} carries, its pose where {mover.name} "
            "reports zero displacement"
        )
    else:
        why = f"flange_from_{kind} for a {kind} that {mover.name} carries, for {mover.name} reports where its flange is"
    others = {f"world_from_{kind}", f"world_from_{kind}0", f"flange_from_{kind}"}.difference(blocks)
    for key in section:
        if key in others:
            with section.faults.noting():
                section.refuse(key, f"must be {why}", key)
