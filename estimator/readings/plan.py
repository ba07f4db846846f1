"""Plans: which poses and currents to visit, in which order."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml

from estimator.errors import Faults, InvalidInput, in_order
from estimator.readings.observations import Observations
from estimator.readings.plan_sections import (
    both_poses,
    check_number_of_stops,
    check_setting,
    quantities_of,
    settings_of,
    values_of_axis,
    whole_number,
)
from estimator.readings.protocol import ORDERS, visits
from estimator.rig.rig import Rig
from estimator.tensors import torch
from estimator.units import UNITS
from estimator.yaml_section import Section

WRITTEN_IN = {"length": "mm", "angle": "deg"}  # units of a written plan
REVISITED = 2.0  # poses, in the recommended protocol


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
    """A plan and its faults, in the order of its lines; None instead of a plan that has any."""
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
            calibration, validation = both_poses(top.section("poses"), rig)
    is_recommended = has_poses and "currents_A" not in top
    currents_A: tuple[Mapping[str, float], ...] = ()
    with noting():
        settle_s = top.number("settle_s", 1.0)
        if settle_s <= 0.0:
            top.refuse("settle_s", "must be > 0", f"{settle_s:g}")
    with noting():
        currents_A = settings_of(top, rig, is_recommended) if has_poses else ()
    with noting():
        order = top.choice("order", ORDERS, "mixed" if is_recommended else "raster")
    with noting():
        repeats = whole_number(top, "repeats", 1.0)
    with noting():
        n_revisited = whole_number(top, "revisited", REVISITED if is_recommended else 0.0, least=0)
    top.finish()
    plan = Plan(
        name, calibration, validation, currents_A, order, repeats, settle_s, tuple(stops), n_revisited
    )
    n_poses = len(calibration) + 2 * plan.n_revisited + len(validation)
    check_number_of_stops(top, (n_poses * len(plan.currents_A) + len(stops)) * plan.repeats)
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


def _stop(section: Section, rig: Rig) -> Stop:
    setting = section.required("current_A")
    check_setting(section, "current_A", setting, rig)
    pose = {}
    for mover in rig.movers:
        block = section.section(mover.name)
        pose[mover.name] = np.array(
            [values_of_axis(block, *quantity, False)[0] for quantity in quantities_of(mover)]
        )
        block.finish()
    is_validation = section.flag("validation")
    section.finish()
    return Stop(pose, {str(name): float(value) for name, value in setting.items()}, is_validation)


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
