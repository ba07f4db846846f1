"""`coilcal report`: the page of a stored calibration."""

from __future__ import annotations

from pathlib import Path

import click

from estimator.cli.command_line import command_of
from estimator.cli.options import PATH, OutputPath, option, result_options
from estimator.cli.output import CoilcalCommand, show


@click.command("report", cls=CoilcalCommand)
@click.argument("folder", metavar="CALIBRATION", type=PATH)
@option("--out", "Page to write; report.html in the folder by default.", OutputPath())
@result_options
def report_command(folder: Path, out: Path | None, overwrite: bool, as_json: bool) -> None:
    """Write the HTML report of CALIBRATION.

    CALIBRATION is a folder written by `coilcal calibrate`.
    """
    from estimator.calibration.report import calibration_report
    from estimator.calibration.result import Calibration
    from estimator.store.staging import check_output, write_output

    path = out or folder / "report.html"
    calibration = Calibration.load(folder)
    check_output(path, overwrite or out is None)
    page = calibration_report(calibration, command_of(click.get_current_context()))
    write_output(path, page, overwrite or out is None)
    show({"report": str(path)}, f"report: {path}", as_json)
