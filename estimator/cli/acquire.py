"""`coilcal acquire`: carry out a plan with the instruments of a rig."""

from __future__ import annotations

import sys
import time
from contextlib import ExitStack
from pathlib import Path

import click

from estimator.cli.options import devices_option, json_option, overwrite_option, seed_option
from estimator.cli.output import CoilcalCommand, refuse_existing, show

FEWEST_READINGS = 6  # `estimator.acquisition.pace` says why; it needs torch
INTERRUPTED = 130


@click.command("acquire", cls=CoilcalCommand)
@click.argument("rig_path", metavar="RIG", type=click.Path(path_type=Path))
@click.argument("plan_path", metavar="PLAN", type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Session to write (zarr).")
@devices_option
@click.option("--dry-run", is_flag=True, help="Show the plan and its duration; touch no instrument.")
@click.option(
    "--readings",
    "n_readings",
    type=click.IntRange(FEWEST_READINGS, 100_000),
    default=10,
    show_default=True,
    help="Readings to average at each stop.",
)
@click.option(
    "--longest-settle",
    "longest_settle_s",
    type=click.FloatRange(min=0.0),
    default=10.0,
    show_default=True,
    help="Seconds to wait for a field that still changes; after that it is taken and marked.",
)
@click.option(
    "--speed",
    "speed_mm_per_s",
    type=click.FloatRange(min=0.0, min_open=True),
    help="Speed of the arms in mm/s; by default the highest that the rig file allows.",
)
@seed_option
@overwrite_option
@json_option
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
    """Carry out PLAN with the instruments of RIG.

    Each stop is on the disk before the next begins. Repeat the command to continue an interrupted measurement. However it ends, the
    currents are ramped to zero. Displacements count from where the arms stand at the start; a finished measurement returns them there.
    """
    from drivers.interlock import sigterm_as_exception
    from estimator.cli.acquire_task import check_plan, measure, plan_record, plan_text, read_task
    from estimator.cli.instruments import Bench
    from estimator.store.journal import read_journal
    from estimator.store.session import is_growing, seal

    is_resumed = is_growing(out) and not overwrite
    if not is_resumed:
        refuse_existing(out, overwrite)
    header, records = read_journal(out) if is_resumed else ({}, [])
    bench = Bench.load(rig_path, devices_path)
    task = read_task(bench, plan_path, n_readings, longest_settle_s, speed_mm_per_s, seed)
    loads = check_plan(task, records, time.time() - header["begin_s"] if records else 0.0)
    if dry_run:
        show(plan_record(task), plan_text(task), as_json)
        return
    try:
        with sigterm_as_exception(), ExitStack() as stack:
            n_before = measure(task, out, is_resumed, loads, stack)
    except (KeyboardInterrupt, SystemExit) as end:
        click.echo(
            "coilcal: interrupted; the currents are off, the arms stay where they are, and the same command goes on",
            err=True,
        )
        sys.exit(end.code if isinstance(end, SystemExit) else INTERRUPTED)
    session = seal(out)
    n_readings_taken = len(session.observations)
    n_validation = int(session.observations.is_validation.sum())
    result = {
        "session": str(out),
        "readings": n_readings_taken,
        "validation": n_validation,
        "stops": len(task.stops),
        "stops_of_earlier_runs": n_before,
        "session_hash": session.hash,
    }
    show(
        result,
        f"{n_readings_taken} readings ({n_validation} of them for validation) written to {out}",
        as_json,
    )
