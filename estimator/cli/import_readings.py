"""`coilcal import`: files of others to a session."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click

from estimator.cli.options import json_option, overwrite_option, seed_option
from estimator.cli.output import explain_errors, named_number, refuse_existing, show
from estimator.model.preflight import check_readings, check_units
from estimator.readings.split import block_split
from estimator.rig_files.read import load_rig
from estimator.store.importers import IMPORTERS
from estimator.store.session import Session


@click.command("import")
@click.argument("paths", metavar="FILES...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--rig", "rig_path", type=click.Path(path_type=Path), required=True, help="Rig file.")
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Session to write (zarr).")
@click.option("--format", "kind", type=click.Choice(list(IMPORTERS)), default="readings", show_default=True)
@click.option(
    "--current", "currents", multiple=True, metavar="COIL=AMPERE", help="Where the files do not say it."
)
@click.option(
    "--validation",
    "share",
    type=float,
    default=0.2,
    show_default=True,
    help="Share kept out of the fit, as whole blocks of neighbouring places; a 'set' column goes first.",
)
@seed_option
@overwrite_option
@json_option
@explain_errors
def import_command(
    paths: tuple[Path, ...],
    rig_path: Path,
    out: Path,
    kind: str,
    currents: tuple[str, ...],
    share: float,
    seed: int,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Import readings FILES into a session.

    `readings` is coilcal's CSV (see the README); the others read maps of public repositories.
    """
    refuse_existing(out, overwrite)
    rig = load_rig(rig_path)
    session = IMPORTERS[kind](paths, rig, named_number(currents, "--current"))
    place = ", ".join(str(path) for path in paths)
    check_readings(rig, session.observations, place)
    check_units(rig, session.observations, place)
    session = _with_validation(session, share, seed)
    check_readings(rig, session.observations, place)  # what is left to fit must suffice, too
    session.save(out, overwrite)
    observations = session.observations
    result = {
        "session": str(out),
        "readings": len(observations),
        "validation": int(observations.is_validation.sum()),
        "session_hash": session.hash,
    }
    text = f"{result['readings']} readings ({result['validation']} of them for validation) written to {out}"
    show(result, text, as_json)


def _with_validation(session: Session, share: float, seed: int) -> Session:
    observations = session.observations
    if observations.is_validation.any():
        return session
    return replace(session, observations=observations.with_validation(block_split(observations, share, seed)))
