"""`coilcal acquire`: carry out a plan with the instruments of a rig."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from estimator.cli.options import PATH, OutputPath, devices_option, flag, option, result_options, seed_option
from estimator.cli.output import EXIT_UNDELIVERED, CoilcalCommand, needing, show
from estimator.errors import CorruptStore

if TYPE_CHECKING:
    from estimator.acquisition.pace import Pace
    from estimator.cli.delivery import Delivery
    from estimator.planning.choosing import Pilot
    from estimator.readings.observations import Observations
    from estimator.rig.rig import Rig
    from estimator.store.session import Session

FEWEST_READINGS = 6  # `estimator.acquisition.pace` says why; it needs torch
DELIVERY_S = 60.0  # to deliver the rest of a session that is complete


@click.command("acquire", cls=CoilcalCommand)
@click.argument("rig_path", metavar="RIG", type=PATH)
@click.argument("plan_path", metavar="[PLAN]", required=False, type=PATH)
@option(
    "--until goals",
    "Choose the stops while measuring, among the places and currents of PLAN, until a goal is reached; goals as in coilcal plan. "
    "Repeatable.",
    multiple=True,
    metavar="GOAL",
)
@option(
    "--most-stops", "With --until: stops after which to end in any case.", click.IntRange(min=1), default=200
)
@option(
    "--minutes",
    "With --until: time after which to end in any case.",
    click.FloatRange(min=0.0, min_open=True),
)
@option("--out", "Session to write (zarr).", OutputPath(), required=True)
@devices_option
@flag("--dry-run", "Show the plan and its duration; touch no instrument.")
@option(
    "--readings n_readings",
    "Readings to average at each stop.",
    click.IntRange(FEWEST_READINGS, 100_000),
    default=10,
)
@option(
    "--longest-settle longest_settle_s",
    "Seconds to wait for a field that still changes; after that it is taken and marked.",
    click.FloatRange(min=0.0),
    default=10.0,
)
@option(
    "--speed speed_mm_per_s",
    "Speed of the arms in mm/s; by default the highest that the rig file allows.",
    click.FloatRange(min=0.0, min_open=True),
)
@option(
    "--to url",
    "Service that gets the readings as they are measured; they wait on disk while it does not answer. COILCAL_TOKEN has its token.",
    metavar="URL",
)
@seed_option
@result_options
def acquire_command(
    rig_path: Path,
    plan_path: Path | None,
    goals: tuple[str, ...],
    most_stops: int,
    minutes: float | None,
    out: Path,
    devices_path: Path | None,
    dry_run: bool,
    url: str | None,
    overwrite: bool,
    as_json: bool,
    **pace: Any,
) -> None:
    """Carry out PLAN with the instruments of RIG, or measure until a goal is reached.

    With --until, each stop is the one of greatest expected gain by second, given the readings so far. Some are held out, visited again or
    without current. The session ends when the goal is reached by held-out stops too, when more stops would not help, or at its limits.

    Each stop is on the disk before the next begins. Repeat the command to continue an interrupted measurement. However it ends, the
    currents are ramped to zero. Displacements count from where the arms stand at the start; a finished measurement returns them there.
    """
    from estimator.cli.acquire_task import check_plan, measured, read_task
    from estimator.cli.contents import ending
    from estimator.cli.instruments import Bench
    from estimator.cli.plan_shown import plan_record, plan_text
    from estimator.planning.autopilot import pilot_of
    from estimator.planning.decision import Limits
    from estimator.store.journal import read_journal
    from estimator.store.made import JOURNAL
    from estimator.store.session import SESSION, is_growing, seal
    from estimator.store.staging import check_output

    is_resumed = is_growing(out) and not overwrite
    if url is not None and not overwrite and not is_resumed and (out / JOURNAL).is_file():
        _deliver_rest(out, url, as_json)
        return
    if not is_resumed:
        check_output(out, overwrite, SESSION)
    header, records = read_journal(out) if is_resumed else ({}, [])
    bench = Bench.load(rig_path, devices_path)
    ends = Limits(most_stops, None if minutes is None else 60.0 * minutes)

    def until_goals(rig: Rig, candidates: Observations, pace: Pace, seed: int) -> Pilot:
        return pilot_of(rig, candidates, goals, pace, ends, seed)

    task = read_task(bench, plan_path, question=until_goals if goals else None, **pace)
    loads = check_plan(task, records, time.time() - header["begin_s"] if records else 0.0)
    if dry_run:
        show(plan_record(task), plan_text(task), as_json)
        return
    delivery = None if url is None else _delivery(out, url, is_new=not is_resumed)
    begin = (lambda: None) if delivery is None else delivery.start
    n_before = measured(task, out, is_resumed, loads, begin)
    session = seal(out)
    n_readings_taken = len(session.observations)
    n_validation = int(session.observations.is_validation.sum())
    result = {
        "session": str(out),
        "readings": n_readings_taken,
        "validation": n_validation,
        "stops": task.n_stops if task.pilot is None else n_readings_taken // len(task.bench.rig.sensors),
        "stops_of_earlier_runs": n_before,
        "session_hash": session.hash,
    }
    words = f"{n_readings_taken} readings ({n_validation} of them for validation) written to {out}"
    if task.pilot is not None:
        why = ending(out)
        result["ended"], words = why, f"{words}\n{why['reason']}"
    _show_delivered(result, words, delivery, session, as_json)


def _delivery(out: Path, url: str, is_new: bool) -> Delivery:
    """The delivery to a service; refused where that takes no readings."""
    with needing("client", "--to"):
        from estimator.cli.delivery import Delivery, connected

    def tell(sentence: str) -> None:
        click.echo(f"coilcal: {sentence}", err=True)

    client = connected(url, os.environ.get("COILCAL_TOKEN"), tell)
    return Delivery(out, client, url, tell, is_new)


def _deliver_rest(out: Path, url: str, as_json: bool) -> None:
    """Deliver what a service has not got of a session that was measured before."""
    from estimator.store.session import load_session

    session = load_session(out)
    delivery = _delivery(out, url, is_new=False)
    delivery.start()
    result = {"session": str(out), "readings": len(session.observations), "session_hash": session.hash}
    _show_delivered(result, f"{out} was complete", delivery, session, as_json)


def _show_delivered(
    result: dict[str, Any], words: str, delivery: Delivery | None, session: Session, as_json: bool
) -> None:
    """Show what was measured, once a service has it or is no longer waited for."""
    if delivery is None:
        show(result, words, as_json)
        return
    receipt = delivery.finish(DELIVERY_S)
    result["delivered"] = {"to": receipt.url, "session": receipt.session_id, "hash": receipt.hash}
    delivered = f", delivered to {receipt.url} as session {receipt.session_id}" if receipt.hash else ""
    show(result, words + delivered, as_json)
    if receipt.hash is None:
        click.echo(
            f"coilcal: {receipt.url} has not got all of them; the same command sends the rest", err=True
        )
        sys.exit(EXIT_UNDELIVERED)
    if receipt.hash != session.hash:
        raise CorruptStore(
            f"session must be the same at {receipt.url} and here; it has the hash {receipt.hash} there and {session.hash} here"
        )
