"""`coilcal import`: from files of readings to a session."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from estimator.cli.form_options import FormOptions, form_options
from estimator.cli.named import named_number
from estimator.cli.options import PATH, OutputPath, flag, option, result_options, seed_option
from estimator.cli.output import CoilcalCommand, show
from estimator.errors import InvalidInput
from estimator.store.importers import IMPORTERS

if TYPE_CHECKING:
    from estimator.rig.rig import Rig
    from estimator.store.importers.forms.recipe import Recipe
    from estimator.store.importers.forms.understand import Understood
    from estimator.store.session import Session

VALIDATION_SHARE = 0.2  # `estimator.store.importers.checked`, which needs torch
UNDATED = "No date is given, so these readings count as recorded now; --recorded-at says when they were."


@click.command("import", cls=CoilcalCommand, takes_derivatives=False)
@click.argument("paths", metavar="FILES...", nargs=-1, required=True, type=PATH)
@option("--rig rig_path", "Rig file.", PATH, required=True)
@option("--out", "Session to write (zarr).", OutputPath(), required=True)
@option("--format kind", "Format of the files.", click.Choice(["readings", *IMPORTERS]), default="readings")
@option(
    "--current currents",
    "Current of a coil, where the files do not hold it. Repeatable.",
    multiple=True,
    metavar="COIL=AMPERE",
)
@option(
    "--validation share",
    "Share of the readings kept out of the fit for validation, as whole blocks of neighbouring poses. A column "
    "'set' in the file takes precedence.",
    float,
    default=VALIDATION_SHARE,
)
@option(
    "--recorded-at",
    "When the readings were taken, as 2026-03-01T09:30+01:00; local time without a zone. Without it the file's column "
    "'recorded_at' counts, else the time of the import. History goes by it.",
    metavar="DATE",
)
@form_options
@flag("--yes", "Accept what was understood of the file, without a question.")
@seed_option
@result_options
def import_command(
    paths: tuple[Path, ...],
    rig_path: Path,
    out: Path,
    form: FormOptions,
    yes: bool,
    overwrite: bool,
    as_json: bool,
    **how: Any,
) -> None:
    """Import FILES with readings into a session.

    The format `readings` is any table of readings: coilcal's own CSV, or what a spreadsheet, an instrument or a script has left. What was
    understood of it is shown and asked, and written as columns.yaml beside the session. The other formats are field maps of public
    repositories.
    """
    from estimator.cli.proposal import write_recipe
    from estimator.readings.clock import now
    from estimator.rig_files.read import load_rig
    from estimator.store.importers.common import moment
    from estimator.store.session import SESSION
    from estimator.store.staging import check_output

    check_output(out, overwrite, SESSION)
    recorded_at = how["recorded_at"]
    created = None if recorded_at is None else moment(recorded_at, "--recorded-at")
    begin = now()
    session, read = _read(paths, load_rig(rig_path), how["kind"], how["currents"], form, yes, not as_json)
    notes = [] if read is None else notes_of(read)
    if created is not None:
        session = replace(session, created=created)
    is_dated = session.created < begin or created is not None
    proposal = None if read is None else read.proposal
    read = None  # the table of a million readings is not needed beside them
    result, lines = _saved(paths, session, notes, out, overwrite, how["share"], how["seed"])
    if proposal is not None and form.map_path is None:
        recipe = write_recipe(proposal, out)
        result["columns"] = str(recipe)
        lines.insert(
            1,
            f"How its columns were read stands in {recipe}; the next file needs no question with --map {recipe}",
        )
    if not is_dated:
        lines.append(UNDATED)
    show(result, "\n".join(lines), as_json)


def _read(
    paths: tuple[Path, ...],
    rig: Rig,
    kind: str,
    currents: tuple[str, ...],
    form: FormOptions,
    yes: bool,
    is_asked: bool,
) -> tuple[Session, Understood | None]:
    """The session that files hold, and what was understood of a table of readings."""
    from estimator.store.session import Session

    named_A = named_number(currents, "--current")
    if kind != "readings":
        return IMPORTERS[kind](paths, rig, named_A), None
    read = _understood(paths, rig, form.with_currents(rig, named_A), yes, is_asked)
    return Session(rig, *read.readings), read


def _saved(
    paths: tuple[Path, ...],
    session: Session,
    notes: list[str],
    out: Path,
    overwrite: bool,
    share: float,
    seed: int,
) -> tuple[dict[str, Any], list[str]]:
    """Check and write a session; what was written, as a record and as lines."""
    from estimator.readings.flags import told
    from estimator.store.importers.checked import checked

    rig, source = session.rig, ", ".join(str(path) for path in paths)
    observations, flags, warnings = checked(rig, session.observations, source, share, seed)
    session = replace(session, observations=observations)
    session.save(out, overwrite)
    warnings = [*notes, *warnings]
    sensors = [sensor.name for sensor in rig.sensors]
    result = {
        "session": str(out),
        "readings": len(observations),
        "validation": int(observations.is_validation.sum()),
        "recorded": session.created,
        "session_hash": session.hash,
        "flagged": [flag.to_json(sensors) for flag in flags],
        "warnings": warnings,
        "columns": None,
    }
    lines = [
        f"{result['readings']} readings ({result['validation']} of them for validation) written to {out}"
    ]
    if flags:
        lines.append(f"{told(flags, sensors)} Put the record right where you can.")
    return result, [*lines, *warnings]


def _understood(paths: tuple[Path, ...], rig: Rig, recipe: Recipe, yes: bool, is_asked: bool) -> Understood:
    """Read a file of readings in whatever form; what had to be guessed is shown, and accepted or refused."""
    from estimator.cli.proposal import settle
    from estimator.store.importers.forms.understand import understood

    if len(paths) != 1:
        raise InvalidInput(
            f"the format readings takes one file, each row with place, currents and field; received {len(paths)}: put them into one"
        )
    read = understood(paths[0], rig, recipe)
    if read.proposal is not None:
        settle(paths[0], read, yes or recipe.is_whole, is_asked)
    return read


def notes_of(read: Understood) -> list[str]:
    """Sentences on what was left out of a file, and on its clock."""
    from estimator.readings.clock import told_of_clock

    observations = read.readings.observations
    told = told_of_clock(observations.time_s.numpy(), observations.sensor.numpy(), read.table.lines)
    return [*read.table.notes, *([told] if told else [])]
