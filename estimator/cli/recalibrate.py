"""`coilcal recalibrate`: new sessions against the current calibration, once or again and again."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from estimator.cli.options import ess_option, json_option, seed_option
from estimator.cli.output import EXIT_DRIFTED, EXIT_NOT_CONVERGED, EXIT_REJECTED, explain_errors, show
from estimator.cli.schedule import interval_s, keep_running
from estimator.errors import InvalidInput
from estimator.inference.ensemble import SamplerSettings
from estimator.recalibration.alerts import senders
from estimator.recalibration.judgement import IS_CONVERGED
from estimator.recalibration.recalibrate import HISTORY, recalibrate, roll_back
from estimator.recalibration.registry import Entry, Registry
from estimator.rig_files.read import load_rig

EXIT_CODES = {"drifted": EXIT_DRIFTED, "rejected": EXIT_REJECTED}
PRECEDENCE = (EXIT_DRIFTED, EXIT_REJECTED, EXIT_NOT_CONVERGED)


@click.command("recalibrate")
@click.option(
    "--rig", "rig_path", type=click.Path(path_type=Path), help="Rig file, with the priors of the beginning."
)
@click.option(
    "--inbox", type=click.Path(path_type=Path), help="Folder where sessions arrive (*.zarr); never changed."
)
@click.option(
    "--registry",
    type=click.Path(path_type=Path),
    required=True,
    help=f"Folder for versions, current, log.jsonl and {HISTORY}; made where it is missing.",
)
@click.option(
    "--every", metavar="TIME", help="Keep running and look into the inbox every 30s, 15m, 6h or 1d."
)
@click.option(
    "--rollback", type=click.IntRange(min=1), metavar="VERSION", help="Make an earlier version current again."
)
@click.option(
    "--again",
    multiple=True,
    metavar="NAME",
    help="Judge a session of the inbox once more although it is in the log; may be given several times.",
)
@click.option(
    "--alert-command",
    metavar="COMMAND",
    help="Run for each drift, rejection and calibration that did not converge, with JSON on its standard input.",
)
@click.option("--alert-webhook", metavar="URL", help="Post the same JSON there.")
@ess_option
@seed_option
@json_option
@explain_errors
def recalibrate_command(
    rig_path: Path | None,
    inbox: Path | None,
    registry: Path,
    every: str | None,
    rollback: int | None,
    again: tuple[str, ...],
    alert_command: str | None,
    alert_webhook: str | None,
    ess: float,
    seed: int,
    as_json: bool,
) -> None:
    """Judge every new session of INBOX against the current calibration of REGISTRY.

    Each is concluded to be unchanged (it agrees, or nothing predicts readings kept out better), updated (the same model explains it with
    other values, and predicts readings kept out better), drifted (a cause is named) or rejected (bad data, or nothing explains it).
    Readings older than those of the current version are judged and never replace it. Sessions in the log are skipped, so the command
    can be repeated at any time, also after it was killed; sessions that are still being measured or copied are left for the next time.
    For cron, systemd (configs/systemd) or Kubernetes (configs/kubernetes).

    Exit codes: 0 nothing new, unchanged or updated; 10 a drift was found; 11 a session was rejected, and none drifted; 4 neither, but a
    calibration did not converge.
    """
    if rollback is not None:
        if rig_path or inbox or every or again:
            raise InvalidInput(
                "--rollback must stand alone beside --registry; received --rig, --inbox, --every or --again too"
            )
        entry = roll_back(registry, rollback)
        show(asdict(entry), entry.reason, as_json)
        return
    if rig_path is None or inbox is None:
        raise InvalidInput("--rig and --inbox must be given, unless --rollback is; received none")
    rig, send = load_rig(rig_path), senders(alert_command, alert_webhook)
    settings = SamplerSettings(target_ess=ess)

    def tell(entry: Entry) -> None:
        if not as_json:
            click.echo(f"{entry.taken[:16]}  {Path(entry.session).name}  {entry.conclusion}: {entry.reason}")
        if _exit_code(entry):
            _alert({"registry": str(registry), **asdict(entry)}, send)

    waiting: set[tuple[Path, str]] = set()

    def wait(path: Path, why: str) -> None:
        if (path, why) not in waiting:  # once, however often --every looks again
            click.echo(f"coilcal: {path} is left for the next time: {why}", err=True)
        waiting.add((path, why))

    left = list(again)

    def once() -> list[Entry]:
        added = recalibrate(
            rig,
            inbox,
            registry,
            seed=seed,
            settings=settings,
            again=tuple(left),
            on_entry=tell,
            on_waiting=wait,
        )
        left.clear()
        return added

    if every is not None:
        keep_running(lambda: _reported(once, registry, as_json), interval_s(every))
        return
    codes = {_exit_code(entry) for entry in _reported(once, registry, as_json)}
    sys.exit(next((code for code in PRECEDENCE if code in codes), 0))


def _exit_code(entry: Entry) -> int:
    """What a conclusion is worth by itself; 0 where nobody has to look."""
    is_unsure = entry.checks.get(IS_CONVERGED) is False
    return EXIT_CODES.get(entry.conclusion, EXIT_NOT_CONVERGED if is_unsure else 0)


def _reported(once: Callable[[], list[Entry]], registry: Path, as_json: bool) -> list[Entry]:
    added = once()
    current = Registry(registry).current
    text = f"{len(added)} new sessions; version {current} is current; {registry / HISTORY}"
    if current is None:
        text = f"{len(added)} new sessions; there is no calibration yet"
    # One line, so that a program can read what --every prints.
    line = {"added": [asdict(entry) for entry in added], "current": current}
    click.echo(json.dumps(line, allow_nan=False) if as_json else text)
    return added


def _alert(message: Mapping[str, Any], send: list[Callable[[Mapping[str, Any]], str | None]]) -> None:
    for one in send:
        problem = one(message)
        if problem is not None:
            click.echo(f"coilcal: {problem}", err=True)
