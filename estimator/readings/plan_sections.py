"""Sections of a plan file: poses as grids, spans or scattered, and settings of the currents."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence

import numpy as np

from estimator.errors import InvalidInput, quoted
from estimator.readings.halton import halton
from estimator.readings.protocol import recommended_currents_A
from estimator.rig.bodies import CARTESIAN, Mover
from estimator.rig.rig import Rig
from estimator.units import LARGEST
from estimator.yaml_section import Section

MOST_STOPS = 200_000  # of a plan; two days at one a second
JOINTS = tuple((f"q{i}", "angle") for i in range(6))


def both_poses(
    section: Section, rig: Rig
) -> tuple[tuple[Mapping[str, np.ndarray], ...], tuple[Mapping[str, np.ndarray], ...]]:
    """Poses for calibration and for validation."""
    calibration: tuple[Mapping[str, np.ndarray], ...] = ()
    validation: tuple[Mapping[str, np.ndarray], ...] = ()
    with section.faults.noting():
        section.required("calibration")
        calibration = _poses(section.section("calibration"), rig)
    with section.faults.noting():
        validation = _poses(section.section("validation"), rig) if "validation" in section else ()
    section.finish()
    return calibration, validation


def _poses(section: Section, rig: Rig) -> tuple[Mapping[str, np.ndarray], ...]:
    """Poses of all movers: a grid over every span, or `scattered` poses that fill the spans evenly (Halton sequence)."""
    names = [mover.name for mover in rig.movers]
    for key in section:
        if key not in (*names, "scattered"):
            received = f"{quoted(key)} instead of {' or '.join(names)}"
            with section.faults.noting():
                section.refuse(key, f"must name a mover of rig {rig.name!r}", received)
    n_scattered = whole_number(section, "scattered") if "scattered" in section else None
    axes: list[tuple[str, int, np.ndarray]] = []
    for mover in rig.movers:
        block = section.section(mover.name)
        quantities = quantities_of(mover)
        is_grid = n_scattered is None
        axes += [
            (mover.name, i, values_of_axis(block, *quantity, is_grid))
            for i, quantity in enumerate(quantities)
        ]
        block.finish()
    section.finish()
    stops = [axis for *_, axis in axes]
    if n_scattered is None:
        check_number_of_stops(section, math.prod(len(axis) for axis in stops))
    rows = itertools.product(*stops) if n_scattered is None else _scattered(stops, n_scattered)
    poses = []
    for values in rows:
        pose = {name: np.zeros(6) for name in names}
        for (name, i, _), value in zip(axes, values, strict=True):
            pose[name][i] = value
        poses.append(pose)
    return tuple(poses)


def quantities_of(mover: Mover) -> tuple[tuple[str, str], ...]:
    """Names in a plan of the six numbers of a mover's pose, with their dimensions."""
    return CARTESIAN if mover.table is None else JOINTS


def _scattered(spans: Sequence[np.ndarray], count: int) -> np.ndarray:
    unit = halton(len(spans), count + 1)[1:]  # the first point is the corner
    low, high = np.array([[span[0], span[-1]] for span in spans]).T
    return np.asarray(low + unit * (high - low))


def values_of_axis(section: Section, quantity: str, dimension: str, is_grid: bool) -> np.ndarray:
    """Values of an axis: 0 if it is absent, a number, the steps of a grid, or the two ends of a span."""
    axis = np.zeros(1)
    with section.faults.noting():
        axis = _axis(section, quantity, dimension, is_grid)
    return axis


def _axis(section: Section, quantity: str, dimension: str, is_grid: bool) -> np.ndarray:
    entry = section.key_with_unit(quantity, dimension)
    if entry is None:
        return np.zeros(1)
    key, unit = entry
    if not section.is_section(key):
        return np.array([section.number(key) * unit.to_si])
    span = section.section(key)
    start, stop = span.number("from"), span.number("to")
    count = whole_number(span, "count") if is_grid else 2
    span.finish()
    return np.linspace(start, stop, count) * unit.to_si


def whole_number(section: Section, key: str, default: float | None = None, least: int = 1) -> int:
    """A whole number of a section that may be so many stops."""
    number = section.number(key, default)
    if number < least or number != int(number):
        section.refuse(key, f"must be a whole number of at least {least}", f"{number:g}")
    if number > MOST_STOPS:
        section.refuse(key, f"must be at most {MOST_STOPS}", f"{number:g}")
    return int(number)


def check_number_of_stops(section: Section, n_stops: int) -> None:
    """Refuse more stops than a plan may have."""
    if n_stops > MOST_STOPS:
        thing = section.path or "the plan"
        raise InvalidInput(
            f"{thing} must have at most {MOST_STOPS} stops; received {n_stops} ({section.file}, line {section.line})"
        )


def settings_of(top: Section, rig: Rig, is_recommended: bool) -> tuple[Mapping[str, float], ...]:
    """The listed settings, or those that the recommended protocol derives from the largest currents."""
    if is_recommended and "largest_A" in top:
        largest_A = top.required("largest_A")
        check_setting(top, "largest_A", largest_A, rig)
        return recommended_currents_A({str(name): float(value) for name, value in largest_A.items()})
    settings = top.required("currents_A")
    if not isinstance(settings, list) or not settings:
        top.refuse("currents_A", "must be a list of settings such as [{coil1: 3}]", repr(settings))
    for setting in settings:
        check_setting(top, "currents_A", setting, rig)
    return tuple({str(k): float(v) for k, v in setting.items()} for setting in settings)


def check_setting(section: Section, key: str, setting: object, rig: Rig) -> None:
    """Refuse what is no setting: currents by coil, all finite."""
    coils = [coil.name for coil in rig.coils]
    if not isinstance(setting, dict) or any(name not in coils for name in setting):
        section.refuse(key, f"must name coils of the rig ({', '.join(coils)})", repr(setting))
    for current in setting.values():
        is_number = isinstance(current, int | float) and not isinstance(current, bool)
        if not is_number or not math.isfinite(current):
            section.refuse(key, "must hold finite numbers", repr(setting))
        if abs(current) > LARGEST:
            section.refuse(key, f"must hold numbers between {-LARGEST:g} and {LARGEST:g}", repr(setting))
