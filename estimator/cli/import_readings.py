"""`coilcal import`: from files of readings to a session."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from estimator.cli.options import OutputPath, json_option, overwrite_option, seed_option
from estimator.cli.output import CoilcalCommand, named_number, show
from estimator.store.importers import IMPORTERS

if TYPE_CHECKING:
    from estimator.store.session import Session

VALIDATION_SHARE = 0.2


@click.command("import", cls=CoilcalCommand)
@click.argument("paths", metavar="FILES...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--rig", "rig_path", type=click.Path(path_type=Path), required=True, help="Rig file.")
@click.option("--out", type=OutputPath(), required=True, help="Session to write (zarr).")
@click.option(
    "--format",
    "kind",
    type=click.Choice(list(IMPORTERS)),
    default="readings",
    show_default=True,
    help="Format of the files.",
)
@click.option(
    "--current",
    "currents",
    multiple=True,
    metavar="COIL=AMPERE",
    help="Current of a coil, where the files do not hold it. Repeatable.",
)
@click.option(
    "--validation",
    "share",
    type=float,
    default=VALIDATION_SHARE,
    show_default=True,
    help="Share of the readings kept out of the fit for validation, as whole blocks of neighbouring poses. A column "
    "'set' in the file takes precedence.",
)
@click.option(
    "--recorded-at",
    metavar="DATE",
    help="When the readings were taken, as 2026-03-01T09:30+01:00; local time without a zone. Without it the file's column "
    "'recorded_at' counts, else the time of the import. History goes by it.",
)
@seed_option
@overwrite_option
@json_option
def import_command(
    paths: tuple[Path, ...],
    rig_path: Path,
    out: Path,
    kind: str,
    currents: tuple[str, ...],
    share: float,
    recorded_at: str | None,
    seed: int,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Import FILES with readings into a session.

    The format `readings` is coilcal's own CSV (docs/how-to/import-your-data.md); the others are field maps of public repositories.
    """
    from estimator.model.preflight import check_readings
    from estimator.model.unit_gate import check_units
    from estimator.readings.digits import flags_of_digits
    from estimator.readings.flags import told, without_flagged
    from estimator.rig_files.read import load_rig
    from estimator.store.importers.recorded import moment
    from estimator.store.session import SESSION
    from estimator.store.staging import check_output

    check_output(out, overwrite, SESSION)
    created = None if recorded_at is None else moment(recorded_at, "--recorded-at")
    rig = load_rig(rig_path)
    session = IMPORTERS[kind](paths, rig, named_number(currents, "--current"))
    if created is not None:
        session = replace(session, created=created)
    source = ", ".join(str(path) for path in paths)
    check_readings(rig, session.observations, source)
    flags = flags_of_digits(session.observations)
    warnings = check_units(rig, without_flagged(session.observations, flags), source)
    session = with_validation(session, share, seed)
    check_readings(rig, session.observations, source)  # the readings left to fit must suffice, too
    session.save(out, overwrite)
    observations, sensors = session.observations, [sensor.name for sensor in rig.sensors]
    result = {
        "session": str(out),
        "readings": len(observations),
        "validation": int(observations.is_validation.sum()),
        "recorded": session.created,
        "session_hash": session.hash,
        "flagged": [flag.to_json(sensors) for flag in flags],
        "warnings": warnings,
    }
    text = f"{result['readings']} readings ({result['validation']} of them for validation) written to {out}"
    if flags:
        text += f"\n{told(flags, sensors)} Put the record right where you can."
    show(result, "\n".join([text, *warnings]), as_json)


def with_validation(session: Session, share: float = VALIDATION_SHARE, seed: int = 0) -> Session:
    """The session with a share of its readings marked for validation, unless the files marked some."""
    from estimator.readings.split import block_split

    observations = session.observations
    if observations.is_validation.any():
        return session
    return replace(session, observations=observations.with_validation(block_split(observations, share, seed)))
