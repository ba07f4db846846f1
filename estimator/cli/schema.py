"""`coilcal schema`: what files may hold, for editors."""

from __future__ import annotations

import json

import click

from estimator.cli.output import CoilcalCommand


@click.group("schema")
def schema_group() -> None:
    """Print a JSON Schema, with which editors complete and check files."""


@schema_group.command("rig", cls=CoilcalCommand)
def schema_rig_command() -> None:
    """Print the JSON Schema of rig files.

    It is made from what the reader of rig files asks for. Ties, geometry and names are checked by the reader alone.
    """
    from estimator.rig_files.schema import rig_schema

    click.echo(json.dumps(rig_schema(), indent=1))


@schema_group.command("calibration", cls=CoilcalCommand)
def schema_calibration_command() -> None:
    """Print the JSON Schema of what `coilcal export --to json` writes."""
    from estimator.export.json_model import calibration_schema

    click.echo(json.dumps(calibration_schema(), indent=1))
