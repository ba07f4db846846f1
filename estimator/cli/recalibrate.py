"""`coilcal recalibrate`: judge new sessions against the current calibration, once or at intervals."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from estimator.cli.options import (
    PATH,
    OutputPath,
    devices_option,
    ess_option,
    json_option,
    option,
    seed_option,
)
from estimator.cli.output import EXIT_DRIFTED, EXIT_NOT_CONVERGED, EXIT_REJECTED, CoilcalCommand, show
from estimator.errors import InvalidInput

if TYPE_CHECKING:
    from estimator.cli.progress import Reporter
    from estimator.inference.ensemble import SamplerSettings
    from estimator.recalibration.log import Entry
    from estimator.rig.rig import Rig

EXIT_CODES = {"drifted": EXIT_DRIFTED, "rejected": EXIT_REJECTED}
PRECEDENCE = (EXIT_DRIFTED, EXIT_REJECTED, EXIT_NOT_CONVERGED)


@click.command("recalibrate", cls=CoilcalCommand, goes_on=True)
@option("--rig rig_path", "Rig file, with the priors of the first calibration.", PATH)
@option("--inbox", "Folder in which sessions (*.zarr) arrive; it is never changed.", PATH)
@option(
    "--registry",
    "Folder for versions, current, log.jsonl and history.html; made if it does not exist.",
    OutputPath(is_filled=True),
    required=True,
)
@option(
    "--every",
    "Keep running and look into the inbox at this interval, such as 30s, 15m, 6h or 1d.",
    metavar="TIME",
)
@option(
    "--rollback",
    "Make this earlier version current again, and do nothing else.",
    click.IntRange(1, 999_999),
    metavar="VERSION",
)
@option(
    "--again",
    "Judge this session of the inbox again although it is in the log. Repeatable.",
    multiple=True,
    metavar="NAME",
)
@option(
    "--alert-command",
    "Command to run at each drift, rejection or calibration that did not converge; it gets JSON on its standard input. "
    "There is no shell: write \"sh -c 'cat >> alerts.jsonl'\" for pipes and redirections.",
    metavar="COMMAND",
)
@option(
    "--measure measured",
    "First measure this session, choosing each stop, until the current version holds or has changed; needs --devices or devices in RIG.",
    OutputPath(),
    metavar="SESSION",
)
@option(
    "--places places_path", "With --measure: plan file with the places and currents to choose from.", PATH
)
@option(
    "--change change_percent",
    "With --measure: change to look for, in per cent of the field in the root mean square over the places.",
    click.FloatRange(min=0.0, min_open=True),
    default=0.5,
)
@option(
    "--most-stops", "With --measure: stops after which to end in any case.", click.IntRange(min=1), default=60
)
@devices_option
@option("--alert-webhook", "Address to which the same JSON is posted.", metavar="URL")
@ess_option
@seed_option
@json_option
def recalibrate_command(
    rig_path: Path | None,
    inbox: Path | None,
    registry: Path,
    every: str | None,
    rollback: int | None,
    again: tuple[str, ...],
    alert_command: str | None,
    alert_webhook: str | None,
    measured: Path | None,
    places_path: Path | None,
    change_percent: float,
    most_stops: int,
    devices_path: Path | None,
    ess: float,
    seed: int,
    as_json: bool,
) -> None:
    """Judge new sessions against the current calibration.

    Every new session of the inbox is judged against the current version of the registry. The conclusion for each session is unchanged (it
    agrees, or nothing predicts the readings kept out better), updated (the same model explains it with other values, and predicts the
    readings kept out better), drifted (a cause is named) or rejected (bad data, or nothing explains it). A session older than the current
    version is judged but never replaces it.

    Sessions in the log are skipped, so the command can be repeated at any time, even after it was killed. Sessions that are still being
    measured or copied wait for the next run. Examples for cron, systemd and Kubernetes are in configs/.

    With --measure, the shortest session is measured that decides whether the current version still holds, and written to SESSION; put it
    into the inbox to have it judged whole. It goes on after an interruption by the same command. Exit codes: 0 it holds; 10 it has
    changed; 4 undecided.

    Exit codes: 0 nothing new, unchanged or updated; 10 a drift was found; 11 a session was rejected, and none drifted; 4 neither, but a
    calibration did not converge.
    """
    if rollback is not None:
        if rig_path or inbox or every or again:
            raise InvalidInput(
                "--rollback must stand alone beside --registry; received --rig, --inbox, --every or --again too"
            )
        _roll_back(registry, rollback, as_json)
        return
    if measured is not None:
        if rig_path is None:
            raise InvalidInput("--rig must be given with --measure; received none")
        from estimator.cli.instruments import Bench
        from estimator.cli.recheck import recheck

        bench = Bench.load(rig_path, devices_path)
        recheck(bench, registry, measured, places_path, change_percent, most_stops, seed, as_json)
        return
    if rig_path is None or inbox is None:
        raise InvalidInput("--rig and --inbox must be given, unless --rollback is; received none")
    from estimator.cli.progress import LINE_EVERY_S, Reporter
    from estimator.inference.ensemble import SamplerSettings
    from estimator.recalibration.alerts import senders
    from estimator.rig_files.read import load_rig

    rig, alert_senders = load_rig(rig_path), senders(alert_command, alert_webhook)
    settings, reporter = SamplerSettings(target_ess=ess), Reporter(LINE_EVERY_S, LINE_EVERY_S)
    judge = _Judge(rig, inbox, registry, seed, settings, alert_senders, as_json, again, reporter)
    if every is not None:
        from estimator.cli.schedule import interval_s, keep_running

        keep_running(judge.judge_inbox, interval_s(every))
        return
    codes = {_exit_code(entry) for entry in judge.judge_inbox()}
    sys.exit(next((code for code in PRECEDENCE if code in codes), 0))


def _roll_back(registry: Path, version: int, as_json: bool) -> None:
    from estimator.recalibration.recalibrate import roll_back

    entry = roll_back(registry, version)
    show(asdict(entry), entry.reason, as_json)


@dataclass
class _Judge:
    """Judges an inbox, as often as it is asked to, and prints what came of it.

    Attributes:
        rig, inbox, registry, seed, settings: As of `recalibrate`.
        alert_senders: Send an entry that needs action; each returns what went wrong.
        as_json: Print a record instead of lines.
        again: Sessions to judge again in the first run that succeeds.
        reporter: Shows how far the work is.
        told_waiting: Sessions that wait, with the reason; each is said once.
    """

    rig: Rig
    inbox: Path
    registry: Path
    seed: int
    settings: SamplerSettings
    alert_senders: Sequence[Callable[[Mapping[str, Any]], str | None]]
    as_json: bool
    again: tuple[str, ...]
    reporter: Reporter
    told_waiting: set[tuple[Path, str]] = field(default_factory=set)

    def judge_inbox(self) -> list[Entry]:
        """Judge the new sessions of the inbox; the entries of the log that this added."""
        from estimator.recalibration.recalibrate import recalibrate
        from estimator.recalibration.registry import HISTORY, Registry
        from estimator.recalibration.watcher import Watcher

        with self.reporter as reporter:
            added = recalibrate(
                self.rig,
                self.inbox,
                self.registry,
                seed=self.seed,
                settings=self.settings,
                again=self.again,
                on_entry=self._tell,
                on_waiting=self._tell_waiting,
                watcher=Watcher(reporter.stage, reporter.fits, reporter.sampling),
            )
        self.again = ()
        current = Registry(self.registry).current
        text = f"{len(added)} new sessions; version {current} is current; {self.registry / HISTORY}"
        if current is None:
            text = f"{len(added)} new sessions; there is no calibration yet"
        result = {"added": [asdict(entry) for entry in added], "current": current}
        # JSON on one line, so that a program can read what --every prints.
        click.echo(json.dumps(result, allow_nan=False) if self.as_json else text)
        return added

    def _tell(self, entry: Entry) -> None:
        """Print an entry of the log, and alert of it if it needs action."""
        from estimator.recalibration.alerts import calls_for_action

        if not self.as_json:
            with self.reporter.aside():
                click.echo(
                    f"{entry.taken[:16]}  {Path(entry.session).name}  {entry.conclusion}: {entry.reason}"
                )
        if calls_for_action(entry):
            message = {"registry": str(self.registry), **asdict(entry)}
            for problem in filter(None, (send(message) for send in self.alert_senders)):
                click.echo(f"coilcal: {problem}", err=True)

    def _tell_waiting(self, path: Path, why: str) -> None:
        """Say once, however often --every looks again, that a session waits."""
        if (path, why) not in self.told_waiting:
            click.echo(f"coilcal: {path} is left for the next time: {why}", err=True)
        self.told_waiting.add((path, why))


def _exit_code(entry: Entry) -> int:
    """Exit code of a conclusion by itself; 0 if it needs no action."""
    from estimator.recalibration.conclusion import IS_CONVERGED

    is_unsure = entry.checks.get(IS_CONVERGED) is False
    return EXIT_CODES.get(entry.conclusion, EXIT_NOT_CONVERGED if is_unsure else 0)
