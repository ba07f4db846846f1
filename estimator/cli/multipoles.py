"""`coilcal multipoles`: what lies right beside the readings of a coil without a winding."""

from __future__ import annotations

from pathlib import Path

import click

from estimator.cli.options import PATH, OutputPath, option, other_rig_option, result_options
from estimator.cli.output import CoilcalCommand, show


@click.command("multipoles", cls=CoilcalCommand)
@click.argument("session_path", metavar="SESSION", type=PATH)
@option("--out", "Rig file to write, for coilcal calibrate --rig.", OutputPath(), required=True)
@other_rig_option
@result_options
def multipoles_command(
    session_path: Path, out: Path, rig_path: Path | None, overwrite: bool, as_json: bool
) -> None:
    """Search for multipoles beside the box of charges of a coil in SESSION.

    They stand for iron that is nearer to the readings than the charges are. Readings for validation are not looked at. The rig file that is
    written has those that readings ask for and resolve; without any it is the rig as it was.
    """
    from estimator.calibration.multipole_places import with_multipoles
    from estimator.rig_files.read import load_rig
    from estimator.rig_files.write import rig_text
    from estimator.store.session import load_session
    from estimator.store.staging import check_output, write_output

    check_output(out, overwrite)
    session = load_session(session_path)
    rig, multipoles = with_multipoles(load_rig(rig_path) if rig_path else session.rig, session.observations)
    write_output(out, rig_text(rig), overwrite)
    places_mm = [[round(1e3 * x_m, 4) for x_m in place_m] for place_m in multipoles.places_m]
    lines = [
        f"multipole at ({', '.join(f'{x_mm:.2f}' for x_mm in place_mm)}) mm: log evidence {gain:+.1f}"
        for place_mm, gain in zip(places_mm, multipoles.gains, strict=True)
    ]
    lines = lines or ["readings ask for no multipole that they resolve; the rig is as it was"]
    told = {"file": str(out), "places_mm": places_mm, "log_evidence_gains": list(multipoles.gains)}
    show(told, "\n".join([*lines, f"rig: {out}"]), as_json)
