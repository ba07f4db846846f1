"""A measurement as `coilcal acquire` prepares, checks and carries it out: plan, instruments, limits and pace."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import click
import torch

from drivers.errors import Refused
from drivers.interlock import sigterm_as_exception
from drivers.limits_section import RigLimits, limits_of
from drivers.open import DeviceSet
from drivers.safety import CoilLoad
from estimator.acquisition.acquire import acquire, references_of
from estimator.acquisition.pace import ANSWER_S, Pace, check_instruments, digest_of, durations_s, stops_of
from estimator.cli.instruments import Bench
from estimator.cli.output import EXIT_INTERRUPTED
from estimator.cli.places import places_of
from estimator.cli.plan_limits import check_currents, check_ways, loads_so_far
from estimator.cli.progress import Reporter
from estimator.errors import InvalidInput
from estimator.frames import Transform
from estimator.planning.candidates import clear_candidates, one_row_each
from estimator.planning.choosing import Pilot
from estimator.readings.observations import Observations
from estimator.readings.plan import Plan, load_plan
from estimator.rig.rig import Rig
from estimator.store.files import write_text
from estimator.store.growing import new_header
from estimator.store.journal import Journal, unwritten
from estimator.store.made import END
from estimator.store.session import remove_session

LINE_EVERY_S = 5.0  # in a pipe
Question: TypeAlias = Callable[[Rig, Observations, Pace, int], Pilot]
"""What a session shall answer whose stops are chosen: who chooses among candidates of a rig, at a pace, with a seed."""


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
    pilot: Pilot | None = None

    @property
    def n_stops(self) -> int:
        """Number of stops of the session, or the most that it may have."""
        return len(self.stops) if self.pilot is None else self.pilot.limits.most_stops


def read_task(
    bench: Bench,
    plan_path: Path | None,
    n_readings: int,
    longest_settle_s: float,
    speed_mm_per_s: float | None,
    seed: int,
    question: Question | None,
) -> Task:
    """Read plan and goals, and refuse whatever can be refused without an instrument."""
    with bench.located():
        limits = limits_of(bench.devices)
    if question is not None:
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
    pilot = question(bench.rig, candidates, pace, seed) if question is not None else None
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


def measured(
    task: Task, out: Path, is_resumed: bool, loads: Mapping[str, CoilLoad], on_begin: Callable[[], None]
) -> int:
    """Measure; an interruption ends the program with the currents off. Arguments and result as of `measure`."""
    try:
        with sigterm_as_exception(), ExitStack() as stack:
            return measure(task, out, is_resumed, loads, stack, on_begin)
    except (KeyboardInterrupt, SystemExit) as end:
        click.echo(
            "coilcal: interrupted; the currents are off, the arms stay where they are, and the same command goes on",
            err=True,
        )
        sys.exit(end.code if isinstance(end, SystemExit) else EXIT_INTERRUPTED)


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
    given = {} if task.pilot is None else task.pilot.header
    for subject, recorded, now in (
        ("rig", journal.header["rig_hash"], task.bench.rig.hash),
        ("plan and seed", journal.header["plan"], digest_of(task.stops)),
        *((key, journal.header.get(key), given.get(key)) for key in ("goals", "test")),
    ):
        if recorded != now:
            raise InvalidInput(
                f"an interrupted session must go on with the {subject} that it began with; {out} began with another "
                "(--overwrite begins anew)"
            )


def _source(task: Task, devices: DeviceSet) -> str:
    identities = [f"{name} {device.identify(timeout_s=ANSWER_S)}" for name, device in devices.devices.items()]
    return f"acquired with plan {task.plan.name!r}, seed {task.seed}, from {'; '.join(identities)}"
