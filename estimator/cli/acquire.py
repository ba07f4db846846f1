"""`coilcal acquire`: a plan carried out with the instruments of a rig."""

from __future__ import annotations

import itertools
import sys
import time
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import torch

from drivers.interlock import sigterm_as_exception
from drivers.limits_section import RigLimits, limits_of
from drivers.open import DeviceSet
from drivers.safety import CoilLoad
from estimator.acquisition.acquire import acquire, references_of
from estimator.acquisition.pace import (
    ANSWER_S,
    FEWEST_READINGS,
    Pace,
    check_instruments,
    digest_of,
    durations_s,
    stops_of,
)
from estimator.cli.acquire_progress import StopReporter
from estimator.cli.instruments import Bench, devices_option
from estimator.cli.options import json_option, overwrite_option, seed_option
from estimator.cli.output import explain_errors, refuse_existing, show
from estimator.cli.plan_limits import check_currents, check_ways, loads_so_far
from estimator.cli.words import duration, place
from estimator.errors import InvalidInput
from estimator.frames import Transform
from estimator.readings.observations import Observations
from estimator.readings.plan import Plan, load_plan
from estimator.store.growing import new_header
from estimator.store.journal import Journal, read_journal, unwritten
from estimator.store.session import is_growing, remove_session, seal

MOST_SHOWN = 10
INTERRUPTED = 130


@dataclass(frozen=True)
class _Task:
    """What is to be done, as far as files tell."""

    bench: Bench
    plan: Plan
    seed: int
    stops: Observations
    limits: RigLimits
    pace: Pace
    times_s: list[float]


@click.command("acquire")
@click.argument("rig_path", metavar="RIG", type=click.Path(path_type=Path))
@click.argument("plan_path", metavar="PLAN", type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Session to write (zarr).")
@devices_option
@click.option("--dry-run", is_flag=True, help="Show the plan and its times; touch no instrument.")
@click.option(
    "--readings",
    "n_readings",
    type=click.IntRange(FEWEST_READINGS, 100_000),
    default=10,
    show_default=True,
    help="To average at a stop.",
)
@click.option(
    "--longest-settle",
    "longest_settle_s",
    type=click.FloatRange(min=0.0),
    default=10.0,
    show_default=True,
    help="Seconds to wait for a field that still changes; then it is taken and marked.",
)
@click.option(
    "--speed",
    "speed_mm_per_s",
    type=click.FloatRange(min=0.0, min_open=True),
    help="Of the arms, in mm/s; by default the highest that the rig allows.",
)
@seed_option
@overwrite_option
@json_option
@explain_errors
def acquire_command(
    rig_path: Path,
    plan_path: Path,
    out: Path,
    devices_path: Path | None,
    dry_run: bool,
    n_readings: int,
    longest_settle_s: float,
    speed_mm_per_s: float | None,
    seed: int,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Visit the stops of PLAN with the instruments of RIG and write what they read, each on the disk before the next begins.

    The same command again goes on where one was interrupted. However it ends, the currents are ramped to zero. Displacements count from
    where the arms stand at the start; there they go back at the end.
    """
    is_resumed = is_growing(out) and not overwrite
    if not is_resumed:
        refuse_existing(out, overwrite)
    header, records = read_journal(out) if is_resumed else ({}, [])
    task = _task(
        Bench.load(rig_path, devices_path), plan_path, n_readings, longest_settle_s, speed_mm_per_s, seed
    )
    now_s = time.time() - header["begin_s"] if records else 0.0
    loads = loads_so_far(records, task.bench.rig, task.limits, now_s)
    check_currents(task.stops, task.bench.rig, task.limits, task.times_s, len(records), loads)
    if dry_run:
        show(_plan_record(task), _plan_text(task), as_json)
        return
    try:
        with sigterm_as_exception(), ExitStack() as stack:
            n_before = _measure(task, out, is_resumed, loads, stack)
    except (KeyboardInterrupt, SystemExit) as end:
        click.echo(
            "coilcal: interrupted; the currents are off, the arms stay where they are, and the same command goes on",
            err=True,
        )
        sys.exit(end.code if isinstance(end, SystemExit) else INTERRUPTED)
    session = seal(out)
    n = len(session.observations)
    n_validation = int(session.observations.is_validation.sum())
    result = {
        "session": str(out),
        "readings": n,
        "validation": n_validation,
        "stops": len(task.stops),
        "stops_of_earlier_runs": n_before,
        "session_hash": session.hash,
    }
    show(result, f"{n} readings ({n_validation} of them for validation) written to {out}", as_json)


def _task(
    bench: Bench,
    plan_path: Path,
    n_readings: int,
    longest_settle_s: float,
    speed_mm_per_s: float | None,
    seed: int,
) -> _Task:
    """Everything that can be refused without an instrument is refused here."""
    plan = load_plan(plan_path, bench.rig)
    stops = stops_of(plan, bench.rig, seed)
    with bench.located():
        limits = limits_of(bench.devices)
    sensors = {name for name, settings in bench.devices.items() if "sensor" in settings}
    check_instruments(
        stops,
        bench.rig,
        {"sensors": sensors, "sources": set(limits.currents), "arms": set(limits.arms)},
    )
    speeds = {
        name: limit.highest_speed_m_per_s if speed_mm_per_s is None else 1e-3 * speed_mm_per_s
        for name, limit in limits.arms.items()
    }
    pace = Pace(plan.settle_s, n_readings, longest_settle_s, speeds, limits.slews_A_per_s)
    check_ways(stops, bench.rig, limits, pace, {})
    times_s = durations_s(stops, bench.rig, pace)
    return _Task(bench, plan, seed, stops, limits, pace, times_s)


def _measure(
    task: _Task, out: Path, is_resumed: bool, loads: Mapping[str, CoilLoad], stack: ExitStack
) -> int:
    """Open, check, visit; how many stops earlier runs had visited."""
    rig = task.bench.rig
    journal = stack.enter_context(Journal.resume(out)) if is_resumed else None
    if journal is not None:
        _check_same(journal, task, out)
    else:
        with unwritten(out):  # nobody opens the instruments of a measurement that is under way
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
        header = new_header(rig, _source(task, devices), digest_of(task.stops), references, len(task.stops))
        journal = stack.enter_context(Journal.create(out, header))
    n_before = len(journal.entries)
    if n_before:
        click.echo(f"coilcal: {n_before} of {len(task.stops)} stops were visited before", err=True)
    with StopReporter(len(task.stops)) as reporter:
        acquire(task.stops, rig, devices, journal, task.pace, reporter)
    return n_before


def _check_same(journal: Journal, task: _Task, out: Path) -> None:
    for what, known, wanted in (
        ("rig", journal.header["rig_hash"], task.bench.rig.hash),
        ("plan and seed", journal.header["plan"], digest_of(task.stops)),
    ):
        if known != wanted:
            raise InvalidInput(
                f"an interrupted session must go on with the {what} that it began with; {out} began with another "
                "(--overwrite begins anew)"
            )


def _source(task: _Task, devices: DeviceSet) -> str:
    names = [f"{name} {device.identify(timeout_s=ANSWER_S)}" for name, device in devices.devices.items()]
    return f"acquired with plan {task.plan.name!r}, seed {task.seed}, from {'; '.join(names)}"


def _plan_record(task: _Task) -> dict[str, Any]:
    rig, stops = task.bench.rig, task.stops
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


def _plan_text(task: _Task) -> str:
    record = _plan_record(task)
    n_validation = int(task.stops.is_validation.sum())
    lines = [
        f"plan {record['plan']!r}: {len(task.stops)} stops ({n_validation} for validation), {record['readings_per_stop']} readings each, "
        f"about {duration(record['duration_s'])}"
    ]
    for number, stop in enumerate(record["stops"][:MOST_SHOWN], start=1):
        currents = ", ".join(f"{name} {current_A:g} A" for name, current_A in stop["current_A"].items())
        places = "; ".join(
            f"{mover.name} {place(mover, stop[mover.name])}" for mover in task.bench.rig.movers
        )
        lines.append(f"  {number:4} after {duration(stop['begin_s']):>10}: {currents}; {places}")
    if len(task.stops) > MOST_SHOWN:
        lines.append(f"  ... and {len(task.stops) - MOST_SHOWN} more (--json lists all)")
    return "\n".join(lines)
