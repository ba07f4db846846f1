"""`coilcal compare`: a field map of a simulation as a rival of the coil model."""

from __future__ import annotations

import json
from pathlib import Path

import click

from estimator.cli.command_line import command_of
from estimator.cli.options import OutputPath, json_option, overwrite_option, seed_option
from estimator.cli.output import CoilcalCommand, show
from estimator.errors import InvalidInput

PAGE, RESULT = "comparison.html", "comparison.json"


@click.command("compare", cls=CoilcalCommand)
@click.argument("path", metavar="SESSION", type=click.Path(path_type=Path))
@click.option(
    "--map",
    "map_path",
    type=click.Path(path_type=Path),
    required=True,
    help="Field map (CSV, COMSOL's too) on a full grid.",
)
@click.option(
    "--coil", metavar="NAME", help="Coil that the map describes; may be left out where there is one."
)
@click.option(
    "--map-current",
    "map_current_A",
    type=float,
    default=1.0,
    show_default=True,
    help="Current in ampere at which the map was computed.",
)
@click.option(
    "--out",
    type=OutputPath(is_filled=True),
    required=True,
    help="Folder for comparison.json and comparison.html.",
)
@seed_option
@overwrite_option
@json_option
def compare_command(
    path: Path,
    map_path: Path,
    coil: str | None,
    map_current_A: float,
    out: Path,
    seed: int,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Say whether a field map, the coil model or neither explains SESSION, and where.

    The map is in the frame of the coil: its origin on the front face, z away from the coil.
    """
    from estimator.comparison.compare import compare
    from estimator.comparison.map_files import read_map
    from estimator.comparison.report import comparison_report, sentences
    from estimator.store.session import load_session
    from estimator.store.staging import check_output, only_writer, write_output

    if map_current_A == 0.0:
        raise InvalidInput("--map-current must not be 0: a map without current says nothing of the coil")
    for name in (PAGE, RESULT):
        check_output(out / name, overwrite)
    session = load_session(path)
    comparison = compare(session, read_map(map_path, map_current_A), coil, seed=seed)
    result = comparison.to_json()
    command = command_of(click.get_current_context())
    with only_writer(out):
        write_output(out / PAGE, comparison_report(comparison, session.source, command), overwrite)
        write_output(out / RESULT, json.dumps(result, indent=2, allow_nan=False) + "\n", overwrite)
    show(result, "\n".join([*sentences(comparison), f"report: {out / PAGE}"]), as_json)
