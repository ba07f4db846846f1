"""`coilcal show`: what a file or folder is, and what it holds."""

from __future__ import annotations

from pathlib import Path

import click

from estimator.cli.options import PATH, json_option
from estimator.cli.output import CoilcalCommand, printable, show


@click.command("show", cls=CoilcalCommand, takes_derivatives=False)
@click.argument("path", metavar="PATH", type=PATH)
@json_option
def show_command(path: Path, as_json: bool) -> None:
    """Say what PATH is and what it holds, in a dozen lines.

    It may be a session, a calibration, a diagnosis, a batch, a registry, a rig file, a plan, a readings CSV, or a folder with some of them.
    """
    from estimator.cli.contents import contents_of

    record, lines = contents_of(path)
    show(record, "\n".join(map(printable, lines)), as_json)
