"""Plans: which poses and currents to visit, in which order."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml

from estimator.errors import Faults, InvalidInput, in_order, quoted
from estimator.readings.observations import Observations
from estimator.readings.protocol import ORDERS, recommended_currents_A, visits
from estimator.rig.bodies import POSE_QUANTITIES, Mover
from estimator.rig.rig import Rig
from estimator.tensors import torch
from estimator.units import LARGEST, UNITS
from estimator.yaml_section import Section

CARTESIAN = POSE_QUANTITIES[:6]  # position and rotation vector; tilts and spin belong to mounts
WRITTEN_IN = {"length": "mm", "angle": "deg"}  # units of a written plan
REVISITED = 2.0  # poses, in the recommended protocol
MOST_STOPS = 200_000  # of a plan; two days at one a second
JOINTS = tuple((f"q{i}", "angle") for i in range(6))


class Stop(NamedTuple):
    """A pose of all movers, as six numbers of each mover's columns in SI, and the currents to set there, in ampere.

    Attributes:
        is_validation: Whether its readings are kept out of the fit.
    """

    pose: Mapping[str, np.ndarray]
    current_A: Mapping[str, float]
    is_validation: bool = False


@dataclass(frozen=True)
class Plan:
    """Poses by role and the currents to set at each of them.

    Attributes:
        calibration, validation: For each pose and mover the six numbers of the mover's columns, in SI.
        currents_A: Settings visited at every pose; coils that are not named are off.
        stops: Single stops, visited after all others in the order of the file.
        order: Poses in the order of the file (`raster`) or at random (`random`); with `mixed`, currents are in random order too.
        repeats: Number of visits to every pose and setting.
        settle_s: Time from one reading to the next.
        n_revisited: Number of calibration poses visited again half-way and at the end.
    """

    name: str
    calibration: tuple[Mapping[str, np.ndarray], ...]
    validation: tuple[Mapping[str, np.ndarray], ...]
    currents_A: tuple[Mapping[str, float], ...]
    order: str
    repeats: int
    settle_s: float
    stops: tuple[Stop, ...] = ()
    n_revisited: int = 0


def load_plan(path: Path | str, rig: Rig) -> Plan:
    """Read a plan for a rig.

    Raises:
        InvalidInput: Unknown key, mover or coil, or missing unit; the message gives file, line, key, rule and value.
    """
    return _plan(Section.from_file(Path(path)), rig)


def plan_from_text(text: str, rig: Rig, file: str = "plan") -> Plan:
    """Read a plan from YAML text; `file` names its origin in messages."""
    return _plan(Section.from_text(text, file), rig)


def plan_and_faults(path: Path | str, rig: Rig) -> tuple[Plan | None, list[InvalidInput]]:
    """A plan with all that is wrong in it, in the order of its lines; None instead of the plan if there is anything."""
    faults = Faults(is_collected=True)
    plan = None
    with faults.noting():
        plan = _plan(Section.from_file(Path(path), faults), rig)
    return (None, in_order(faults.noted)) if faults.noted else (plan, [])


def _plan(top: Section, rig: Rig) -> Plan:
    noting = top.faults.noting
    name, settle_s, order, repeats, n_revisited = "", 1.0, "raster", 1, 0
    with noting():
        if top.required("schema_version") != 1:
            top.refuse("schema_version", "must be 1", repr(top.value("schema_version")))
    with noting():
        name = str(top.required("name"))
    stops: list[Stop] = []
    with noting():
        for entry in top.sections("stops"):
            with noting():
                stops.append(_stop(entry, rig))
    calibration: tuple[Mapping[str, np.ndarray], ...] = ()
    validation: tuple[Mapping[str, np.ndarray], ...] = ()
    has_poses = "poses" in top or "stops" not in top
    if has_poses:
        with noting():
            if "poses" not in top:
                top.required("poses")
            calibration, validation = _both_poses(top.section("poses"), rig)
    is_recommended = has_poses and "currents_A" not in top
    currents_A: tuple[Mapping[str, float], ...] = ()
    with noting():
        settle_s = top.number("settle_s", 1.0)
        if settle_s <= 0.0:
            top.refuse("settle_s", "must be > 0", f"{settle_s:g}")
    with noting():
        currents_A = _currents(top, rig, is_recommended) if has_poses else ()
    with noting():
        order = top.choice("order", ORDERS, "mixed" if is_recommended else "raster")
    with noting():
        repeats = _count(top, "repeats", 1.0)
    with noting():
        n_revisited = _count(top, "revisited", REVISITED if is_recommended else 0.0, least=0)
    top.finish()
    plan = Plan(
        name, calibration, validation, currents_A, order, repeats, settle_s, tuple(stops), n_revisited
    )
    n_poses = len(calibration) + 2 * plan.n_revisited + len(validation)
    _check_stops(top, (n_poses * len(plan.currents_A) + len(stops)) * plan.repeats)
    return plan


def observations_of(plan: Plan, rig: Rig, rng: np.random.Generator) -> Observations:
    """Readings that the plan asks for, their field still NaN: one row per sensor and setting, in order of the visits."""
    rows: list[tuple[Mapping[str, np.ndarray], Mapping[str, float], bool, int]] = []
    for is_validation, poses in ((False, plan.calibration), (True, plan.validation)):
        n_revisited = 0 if is_validation else plan.n_revisited
        for repeat in range(plan.repeats):
            for pose, number in visits(len(poses), n_revisited, plan.order, rng):
                settings = np.arange(len(plan.currents_A))
                if plan.order == "mixed":
                    settings = rng.permutation(settings)
                visit = number * plan.repeats + repeat
                rows += [(poses[pose], plan.currents_A[i], is_validation, visit) for i in settings]
    rows += [(*stop, repeat) for repeat in range(plan.repeats) for stop in plan.stops]
    n_sensors = len(rig.sensors)
    times = [i * plan.settle_s for i in range(len(rows)) for _ in range(n_sensors)]
    current_A = [[setting.get(coil.name, 0.0) for coil in rig.coils] for _, setting, _, _ in rows]
    motion = {
        mover.name: torch.from_numpy(np.repeat([pose[mover.name] for pose, *_ in rows], n_sensors, axis=0))
        for mover in rig.movers
    }
    return Observations(
        torch.tensor(times, dtype=torch.float64),
        torch.arange(n_sensors).repeat(len(rows)),
        torch.tensor(current_A, dtype=torch.float64).repeat_interleave(n_sensors, dim=0),
        motion,
        torch.full((len(times), 3), torch.nan, dtype=torch.float64),
        torch.tensor([v for _, _, v, _ in rows]).repeat_interleave(n_sensors),
        torch.tensor([r for _, _, _, r in rows]).repeat_interleave(n_sensors),
        {},
    )


def _both_poses(
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
    n_scattered = _count(section, "scattered") if "scattered" in section else None
    axes: list[tuple[str, int, np.ndarray]] = []
    for mover in rig.movers:
        block = section.section(mover.name)
        quantities = quantities_of(mover)
        is_grid = n_scattered is None
        axes += [(mover.name, i, _stops(block, *quantity, is_grid)) for i, quantity in enumerate(quantities)]
        block.finish()
    section.finish()
    stops = [axis for *_, axis in axes]
    if n_scattered is None:
        _check_stops(section, math.prod(len(axis) for axis in stops))
    rows = itertools.product(*stops) if n_scattered is None else _scattered(stops, n_scattered)
    poses = []
    for values in rows:
        pose = {name: np.zeros(6) for name in names}
        for (name, i, _), value in zip(axes, values, strict=True):
            pose[name][i] = value
        poses.append(pose)
    return tuple(poses)


def _stop(section: Section, rig: Rig) -> Stop:
    setting = section.required("current_A")
    _check_setting(section, "current_A", setting, rig)
    pose = {}
    for mover in rig.movers:
        block = section.section(mover.name)
        pose[mover.name] = np.array([_stops(block, *quantity, False)[0] for quantity in quantities_of(mover)])
        block.finish()
    is_validation = section.flag("validation")
    section.finish()
    return Stop(pose, {str(name): float(value) for name, value in setting.items()}, is_validation)


def quantities_of(mover: Mover) -> tuple[tuple[str, str], ...]:
    """Names in a plan of the six numbers of a mover's pose, with their dimensions."""
    return CARTESIAN if mover.table is None else JOINTS


def _scattered(spans: Sequence[np.ndarray], count: int) -> np.ndarray:
    unit = halton(len(spans), count + 1)[1:]  # the first point is the corner
    low, high = np.array([[span[0], span[-1]] for span in spans]).T
    return np.asarray(low + unit * (high - low))


def halton(n_axes: int, count: int) -> np.ndarray:
    """The first points of Halton's sequence in the unit cube, a row each. `scipy.stats.qmc` has it, too, and takes a second to load.

    Examples:
        >>> halton(2, 4).tolist()
        [[0.0, 0.0], [0.5, 0.3333333], [0.25, 0.6666667], [0.75, 0.1111111]]
    """
    points = np.zeros((count, n_axes))
    for axis, base in enumerate(_primes(n_axes)):
        left, place = np.arange(count), 1.0 / base
        while left.any():
            left, digit = np.divmod(left, base)
            points[:, axis] += digit * place
            place /= base
    return points


def _primes(count: int) -> list[int]:
    primes: list[int] = []
    for number in itertools.count(2):
        if len(primes) == count:
            break
        if all(number % prime for prime in primes):
            primes.append(number)
    return primes


def _stops(section: Section, quantity: str, dimension: str, is_grid: bool) -> np.ndarray:
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
    count = _count(span, "count") if is_grid else 2
    span.finish()
    return np.linspace(start, stop, count) * unit.to_si


def _count(section: Section, key: str, default: float | None = None, least: int = 1) -> int:
    number = section.number(key, default)
    if number < least or number != int(number):
        section.refuse(key, f"must be a whole number of at least {least}", f"{number:g}")
    if number > MOST_STOPS:
        section.refuse(key, f"must be at most {MOST_STOPS}", f"{number:g}")
    return int(number)


def _check_stops(section: Section, n_stops: int) -> None:
    if n_stops > MOST_STOPS:
        thing = section.path or "the plan"
        raise InvalidInput(
            f"{thing} must have at most {MOST_STOPS} stops; received {n_stops} ({section.file}, line {section.line})"
        )


def _currents(top: Section, rig: Rig, is_recommended: bool) -> tuple[Mapping[str, float], ...]:
    """The listed settings, or those that the recommended protocol derives from the largest currents."""
    if is_recommended and "largest_A" in top:
        largest_A = top.required("largest_A")
        _check_setting(top, "largest_A", largest_A, rig)
        return recommended_currents_A({str(name): float(value) for name, value in largest_A.items()})
    settings = top.required("currents_A")
    if not isinstance(settings, list) or not settings:
        top.refuse("currents_A", "must be a list of settings such as [{coil1: 3}]", repr(settings))
    for setting in settings:
        _check_setting(top, "currents_A", setting, rig)
    return tuple({str(k): float(v) for k, v in setting.items()} for setting in settings)


def _check_setting(section: Section, key: str, setting: object, rig: Rig) -> None:
    coils = [coil.name for coil in rig.coils]
    if not isinstance(setting, dict) or any(name not in coils for name in setting):
        section.refuse(key, f"must name coils of the rig ({', '.join(coils)})", repr(setting))
    for current in setting.values():
        is_number = isinstance(current, int | float) and not isinstance(current, bool)
        if not is_number or not math.isfinite(current):
            section.refuse(key, "must hold finite numbers", repr(setting))
        if abs(current) > LARGEST:
            section.refuse(key, f"must hold numbers between {-LARGEST:g} and {LARGEST:g}", repr(setting))


def plan_text(
    name: str, rig: Rig, readings: Observations, settle_s: float, reasons: Sequence[str] = ()
) -> str:
    """Text of a plan file that visits the poses and currents of some readings one by one.

    Args:
        name: Name of the plan.
        rig: Names movers and coils.
        readings: One row per stop.
        settle_s: Time from one reading to the next.
        reasons: Why each stop is there, as a comment in its line; none by default.
    """
    head = {"schema_version": 1, "name": name, "settle_s": round(settle_s, 3)}
    lines = [yaml.safe_dump(head, sort_keys=False, width=math.inf), "stops:\n"]
    for row in range(len(readings)):
        stop: dict[str, object] = {}
        for mover in rig.movers:
            numbers = zip(quantities_of(mover), readings.motion[mover.name][row].tolist(), strict=True)
            stop[mover.name] = {
                f"{q}_{WRITTEN_IN[d]}": round(v / UNITS[WRITTEN_IN[d]].to_si, 4)
                for (q, d), v in numbers
                if v != 0.0
            }
        currents = zip(rig.coils, readings.current_A[row].tolist(), strict=True)
        stop["current_A"] = {coil.name: round(current, 6) for coil, current in currents}
        if readings.is_validation[row]:
            stop["validation"] = True
        entry = yaml.safe_dump(stop, sort_keys=False, default_flow_style=True, width=math.inf).rstrip()
        lines.append(f"- {entry}  # {reasons[row]}\n" if reasons else f"- {entry}\n")
    return "".join(lines)
