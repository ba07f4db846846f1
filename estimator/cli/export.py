"""`coilcal export`: a calibration for other programs and languages."""

from __future__ import annotations

from pathlib import Path

import click

from estimator.cli.grid import grid_axes
from estimator.cli.named import named_motions, named_number
from estimator.cli.options import PATH, OutputPath, flag, option, result_options
from estimator.cli.output import CoilcalCommand, show
from estimator.export.formats import FORMATS

TABLE = "\n".join(f"{name:10} {chosen.words}" for name, chosen in FORMATS.items())


@click.command(
    "export",
    cls=CoilcalCommand,
    takes_derivatives=False,
    help="Write the model of CALIBRATION for other programs.\n\nCALIBRATION is a folder written by `coilcal calibrate`. Several are "
    "written as one magnet: each with the coils that were on in it, all in the same world frame. Formats:\n\n\b\n"
    + TABLE,
)
@click.argument("folders", metavar="CALIBRATION...", nargs=-1, required=True, type=PATH)
@option("--to", "Format.", click.Choice(list(FORMATS)), required=True)
@option("--out", "File to write; by default one named after the rig, in this folder.", OutputPath())
@option(
    "--grid axes",
    "Points of a field, as in coilcal predict. Repeatable.",
    multiple=True,
    metavar="AXIS=FROM:TO:COUNT",
)
@option(
    "--current currents", "Current of a coil for a field. Repeatable.", multiple=True, metavar="COIL=AMPERE"
)
@option(
    "--motion motions",
    "Pose of a mover, for formats in which nothing moves. Repeatable.",
    multiple=True,
    metavar="MOVER=V1,..,V6",
)
@flag("--coils-alone", "Leave out what is there without current, such as the Earth's field.")
@result_options
def export_command(
    folders: tuple[Path, ...],
    to: str,
    out: Path | None,
    axes: tuple[str, ...],
    currents: tuple[str, ...],
    motions: tuple[str, ...],
    coils_alone: bool,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Write the model of CALIBRATION for other programs."""
    from estimator.calibration.result import Calibration
    from estimator.export.formats import default_path, export
    from estimator.export.request import Grid
    from estimator.store.staging import check_output

    loaded = [Calibration.load(folder) for folder in folders]
    if coils_alone:
        loaded = [calibration.coils_alone() for calibration in loaded]
    calibrated: Calibration | System = loaded[0]
    if len(loaded) > 1:
        from estimator.system.system import System

        calibrated = System.of(*loaded)
    path = default_path(calibrated.magnet(), to) if out is None else out
    check_output(path, overwrite)
    grid = Grid(*grid_axes(axes).values()) if axes else None
    export(
        calibrated.magnet(),
        to,
        path,
        grid=grid,
        currents_A=named_number(currents, "--current"),
        motion=named_motions(motions),
        overwrite=overwrite,
    )
    show({"file": str(path), "format": to}, f"{FORMATS[to].words} written to {path}", as_json)
