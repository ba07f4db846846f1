"""`coilcal compare`: two calibrations side by side, or a field map of a simulation as a rival of the coil model."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from estimator.cli.command_line import command_of
from estimator.cli.options import PATH, OutputPath, option, result_options, seed_option
from estimator.cli.output import CoilcalCommand, show
from estimator.errors import InvalidInput
from estimator.glance import aligned

PAGE, RESULT = "comparison.html", "comparison.json"
Compared = tuple[dict[str, Any], list[str], str]  # as a record, as lines, and as a page


@click.command("compare", cls=CoilcalCommand)
@click.argument("paths", metavar="CALIBRATION CALIBRATION | SESSION", nargs=-1, required=True, type=PATH)
@option("--map map_path", "Field map (CSV, COMSOL's too) on a full grid.", PATH)
@option("--coil", "Coil that the map describes; may be left out where there is one.", metavar="NAME")
@option("--map-current map_current_A", "Current in ampere at which the map was computed.", float, default=1.0)
@option("--out", "Folder for comparison.json and comparison.html.", OutputPath(is_filled=True), required=True)
@seed_option
@result_options
def compare_command(
    paths: tuple[Path, ...],
    map_path: Path | None,
    coil: str | None,
    map_current_A: float,
    out: Path,
    seed: int,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Put two calibrations side by side, or say whether a field map, the coil model or neither explains SESSION, and where.

    Of two calibrations: their numbers, and the difference of their fields in the plane through the axis of each coil. With --map: the map
    is in the frame of the coil, its origin on the front face, z away from the coil.
    """
    from estimator.store.staging import check_output, only_writer, write_output

    for name in (PAGE, RESULT):
        check_output(out / name, overwrite)
    command = command_of(click.get_current_context())
    if map_path is None:
        result, lines, page = _calibrations(paths, command)
    else:
        result, lines, page = _map(paths, map_path, map_current_A, coil, seed, command)
    with only_writer(out):
        write_output(out / PAGE, page, overwrite)
        write_output(out / RESULT, json.dumps(result, indent=2, allow_nan=False) + "\n", overwrite)
    show(result, "\n".join([*lines, f"report: {out / PAGE}"]), as_json)


def _calibrations(paths: tuple[Path, ...], command: str) -> Compared:
    from estimator.calibration.result import Calibration
    from estimator.comparison.calibrations import side_by_side
    from estimator.comparison.calibrations_report import number_table, sentences, side_by_side_report

    if len(paths) != 2:
        raise InvalidInput(
            f"two calibrations are compared, or a session with the --map of a simulation; received {len(paths)} without --map"
        )
    first, second = (Calibration.load(path) for path in paths)
    compared = side_by_side(first, second, (str(paths[0]), str(paths[1])))
    table = number_table(compared)
    lines = aligned([table.header, *table.rows])
    return compared.to_json(), [*sentences(compared), "", *lines], side_by_side_report(compared, command)


def _map(
    paths: tuple[Path, ...], map_path: Path, map_current_A: float, coil: str | None, seed: int, command: str
) -> Compared:
    from estimator.comparison.compare import compare
    from estimator.comparison.map_files import read_map
    from estimator.comparison.report import comparison_report, sentences
    from estimator.store.session import load_session

    if len(paths) != 1:
        raise InvalidInput(f"--map is compared on one session; received {len(paths)}")
    if map_current_A == 0.0:
        raise InvalidInput("--map-current must not be 0: a map without current says nothing of the coil")
    session = load_session(paths[0])
    comparison = compare(session, read_map(map_path, map_current_A), coil, seed=seed)
    return comparison.to_json(), sentences(comparison), comparison_report(comparison, session.source, command)
