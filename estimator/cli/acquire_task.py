"""A measurement as `coilcal acquire` prepares, checks and carries it out: plan, instruments, limits and pace."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import torch

from drivers.errors import Refused
from drivers.limits_section import RigLimits, limits_of
from drivers.open import DeviceSet
from drivers.safety import CoilLoad
from estimator.acquisition.acquire import acquire, references_of
from estimator.acquisition.pace import ANSWER_S, Pace, check_instruments, digest_of, durations_s, stops_of
from estimator.cli.instruments import Bench
from estimator.cli.places import places_of
from estimator.cli.plan_limits import check_currents, check_ways, loads_so_far
from estimator.cli.progress import Reporter
from estimator.cli.words import duration_words, motion_words
from estimator.errors import InvalidInput
from estimator.frames import Transform
from estimator.planning.autopilot import Autopilot, pilot_of
from estimator.planning.candidates import clear_candidates, one_row_each
from estimator.planning.decision import Limits
from estimator.readings.observations import Observations
from estimator.readings.plan import Plan, load_plan
from estimator.store.files import write_text
from estimator.store.growing import new_header
from estimator.store.journal import Journal, unwritten
from estimator.store.made import END
from estimator.store.session import remove_session

MOST_SHOWN = 10
LINE_EVERY_S = 5.0  # in a pipe


@dataclass(frozen=True)
class Task:
    """A measurement as its files describe it.

    Attributes:
        bench: Rig and instruments.
        plan: The plan file.
        seed: Seed of the random order of the stops.
        stops: Poses and currents in the order in which they are visited.
        limits: Limits of the instruments.
        pace: Speeds of the arms, readings per stop, and how long to wait for the field to settle.
        times_s: Expected duration of each stop.
        pilot: Chooses among the stops where goals are given instead of a plan.
    """

    bench: Bench
    plan: Plan
    seed: int
    stops: Observations
    limits: RigLimits
    pace: Pace
    times_s: list[float]
    pilot: Autopilot | None = None

    @property
    def n_stops(self) -> int:
        """Number of stops of the session, or the most that it may have."""
        return len(self.stops) if self.pilot is None else self.pilot.limits.most_stops


@dataclass(frozen=True)
class Until:
    """Goals of a session whose stops are chosen while it is measured.

    Attributes:
        goals: As the user wrote them; none for a plan that is carried out.
        ends: Limits of stops and time.
    """

    goals: tuple[str, ...]
    ends: Limits


def read_task(
    bench: Bench,
    plan_path: Path | None,
    n_readings: int,
    longest_settle_s: float,
    speed_mm_per_s: float | None,
    seed: int,
    until: Until,
) -> Task:
    """Read plan and goals, and refuse whatever can be refused without an instrument."""
    with bench.located():
        limits = limits_of(bench.devices)
    if until.goals:
        plan = places_of(bench.rig, plan_path, limits, is_any_order=True)
        candidates = clear_candidates(plan, bench.rig, seed)
        stops = one_row_each(candidates, bench.rig)
    elif plan_path is not None:
        plan = load_plan(plan_path, bench.rig)
        stops = stops_of(plan, bench.rig, seed)
    else:
        raise InvalidInput(
            "acquire must be given a PLAN to carry out, or goals with --until; received neither"
        )
    sensors = {name for name, settings in bench.devices.items() if "sensor" in settings}
    instruments = {"sensors": sensors, "sources": set(limits.currents), "arms": set(limits.arms)}
    check_instruments(stops, bench.rig, instruments)
    speeds = {
        name: limit.highest_speed_m_per_s if speed_mm_per_s is None else 1e-3 * speed_mm_per_s
        for name, limit in limits.arms.items()
    }
    pace = Pace(plan.settle_s, n_readings, longest_settle_s, speeds, limits.slews_A_per_s)
    check_ways(stops, bench.rig, limits, pace, {})
    times_s = durations_s(stops, bench.rig, pace)
    pilot = pilot_of(bench.rig, candidates, until.goals, pace, until.ends, seed) if until.goals else None
    return Task(bench, plan, seed, stops, limits, pace, times_s, pilot)


def check_plan(task: Task, records: Sequence[Mapping[str, Any]], now_s: float) -> dict[str, CoilLoad]:
    """Refuse a plan whose remaining stops would overload a coil.

    Args:
        task: The measurement.
        records: Stops that earlier runs have visited, as the journal holds them.
        now_s: Time since the session began.
    Returns: What earlier runs left in each coil.
    """
    loads = loads_so_far(records, task.bench.rig, task.limits, now_s)
    if task.pilot is None:  # which chooses among currents that a coil bears for ever
        check_currents(task.stops, task.bench.rig, task.limits, task.times_s, len(records), loads)
    return loads


def measure(
    task: Task,
    out: Path,
    is_resumed: bool,
    loads: Mapping[str, CoilLoad],
    stack: ExitStack,
    on_begin: Callable[[], None],
) -> int:
    """Open the instruments, check the ways of the arms and visit the stops; `on_begin` is called when there is a journal.

    Returns: Number of stops that earlier runs had visited.
    """
    rig = task.bench.rig
    journal = stack.enter_context(Journal.resume(out)) if is_resumed else None
    if journal is not None:
        _check_same(journal, task, out)
    else:
        with unwritten(out):  # refuses a measurement that is under way before its instruments are opened
            pass
    devices = stack.enter_context(task.bench.opened())
    devices.begin_with(loads)
    references = journal.header["references"] if journal is not None else references_of(rig, devices)
    at_reference = {
        name: Transform.from_pose(*torch.tensor([pose], dtype=torch.float64).split(3, dim=1))
        for name, pose in references.items()
    }
    check_ways(task.stops, rig, task.limits, task.pace, at_reference)
    if journal is None:
        if out.exists():
            remove_session(out)
        header = new_header(rig, _source(task, devices), digest_of(task.stops), references, task.n_stops)
        header |= {} if task.pilot is None else task.pilot.header
        journal = stack.enter_context(Journal.create(out, header))
    on_begin()
    n_before = len(journal.entries)
    if n_before:
        click.echo(f"coilcal: {n_before} of {task.n_stops} stops were visited before", err=True)
    choose = None if task.pilot is None else task.pilot.choose
    with Reporter(LINE_EVERY_S) as reporter:
        acquire(task.stops, rig, devices, journal, task.pace, reporter.visits, choose, task.n_stops, _tell)
    if task.pilot is not None:
        write_text(out / END, json.dumps(task.pilot.decide(journal.entries).to_json()))
    return n_before


def _tell(refusal: Refused) -> None:
    """Say that a stop is skipped."""
    click.echo(f"coilcal: a stop was refused, another one is chosen: {refusal}", err=True)


def _check_same(journal: Journal, task: Task, out: Path) -> None:
    """Refuse to continue a session with another rig, plan or seed."""
    for subject, recorded, given in (
        ("rig", journal.header["rig_hash"], task.bench.rig.hash),
        ("plan and seed", journal.header["plan"], digest_of(task.stops)),
        ("goals", journal.header.get("goals"), None if task.pilot is None else task.pilot.header["goals"]),
    ):
        if recorded != given:
            raise InvalidInput(
                f"an interrupted session must go on with the {subject} that it began with; {out} began with another "
                "(--overwrite begins anew)"
            )


def _source(task: Task, devices: DeviceSet) -> str:
    identities = [f"{name} {device.identify(timeout_s=ANSWER_S)}" for name, device in devices.devices.items()]
    return f"acquired with plan {task.plan.name!r}, seed {task.seed}, from {'; '.join(identities)}"


def plan_record(task: Task) -> dict[str, Any]:
    """The planned stops, for programs."""
    rig, stops = task.bench.rig, task.stops
    if task.pilot is not None:
        return {"candidates": len(stops), **task.pilot.header, "first": task.pilot.decide([]).to_json()}
    begins_s = list(itertools.accumulate(task.times_s, initial=0.0))
    return {
        "plan": task.plan.name,
        "readings_per_stop": task.pace.n_readings,
        "duration_s": sum(task.times_s),
        "stops": [
            {
                "begin_s": begins_s[row],
                "current_A": {coil.name: float(stops.current_A[row, i]) for i, coil in enumerate(rig.coils)},
                **{mover.name: stops.motion[mover.name][row].tolist() for mover in rig.movers},
                "is_validation": bool(stops.is_validation[row]),
            }
            for row in range(len(stops))
        ],
    }


def plan_text(task: Task) -> str:
    """The first planned stops and the duration, for people."""
    record = plan_record(task)
    if task.pilot is not None:
        return "\n".join(
            [
                f"{record['candidates']} stops to choose from, at most {task.n_stops} visits",
                *(f"goal: {goal}" for goal in record["goals"]),
            ]
        )
    n_validation = int(task.stops.is_validation.sum())
    lines = [
        f"plan {record['plan']!r}: {len(task.stops)} stops ({n_validation} for validation), {record['readings_per_stop']} readings each, "
        f"about {duration_words(record['duration_s'])}"
    ]
    for number, stop in enumerate(record["stops"][:MOST_SHOWN], start=1):
        currents = ", ".join(f"{name} {current_A:g} A" for name, current_A in stop["current_A"].items())
        motions = "; ".join(
            f"{mover.name} {motion_words(mover, stop[mover.name])}" for mover in task.bench.rig.movers
        )
        lines.append(f"  {number:4} after {duration_words(stop['begin_s']):>10}: {currents}; {motions}")
    if len(task.stops) > MOST_SHOWN:
        lines.append(f"  ... and {len(task.stops) - MOST_SHOWN} more (--json lists all)")
    return "\n".join(lines)
