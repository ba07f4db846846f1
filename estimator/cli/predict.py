"""`coilcal predict`: the field of a calibration with credible intervals, on a grid."""

from __future__ import annotations

import csv
import io
import math
from pathlib import Path
from typing import TYPE_CHECKING

import click

from estimator.cli.options import json_option, overwrite_option
from estimator.cli.output import CoilcalCommand, named_number, named_numbers, refuse_existing, show
from estimator.errors import InvalidInput, reason

if TYPE_CHECKING:
    import numpy as np

MOST_POINTS = 1_000_000
BLOCK = 10_000  # points predicted at once, with all draws of the posterior
HEADER = (
    ["x_m", "y_m", "z_m"]
    + [f"B{axis}_T" for axis in "xyz"]
    + [f"B{axis}_{end}_T" for axis in "xyz" for end in ("lower", "upper")]
    + ["inside_winding"]
)


@click.command("predict", cls=CoilcalCommand)
@click.argument("folder", metavar="CALIBRATION", type=click.Path(path_type=Path))
@click.option(
    "--grid",
    "axes",
    multiple=True,
    required=True,
    metavar="AXIS=FROM:TO:COUNT",
    help="Points along an axis of the world frame, such as x_mm=-50:50:11. An axis left out is 0. Repeatable.",
)
@click.option(
    "--current",
    "currents",
    multiple=True,
    required=True,
    metavar="COIL=AMPERE",
    help="Current of a coil, such as coil1=3. Repeatable.",
)
@click.option(
    "--motion",
    "motions",
    multiple=True,
    metavar="MOVER=V1,..,V6",
    help="Pose of a mover: the six numbers of its columns, in SI units. Repeatable.",
)
@click.option(
    "--level", type=float, default=0.9, show_default=True, help="Probability of the credible intervals."
)
@click.option("--out", type=click.Path(path_type=Path), required=True, help="CSV file to write.")
@overwrite_option
@json_option
def predict_command(
    folder: Path,
    axes: tuple[str, ...],
    currents: tuple[str, ...],
    motions: tuple[str, ...],
    level: float,
    out: Path,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Write the field of CALIBRATION with credible intervals.

    Points lie on a grid in the world frame; the output is CSV. CALIBRATION is a folder written by `coilcal calibrate`.
    """
    import numpy as np
    import torch

    from estimator.calibration.result import Calibration
    from estimator.store.files import write_text

    refuse_existing(out, overwrite)
    calibration = Calibration.load(folder)
    grid = [_axis(text) for text in axes]
    if len({name for name, _ in grid}) < len(grid):
        raise InvalidInput(f"--grid must name an axis once; received {', '.join(axes)}")
    n_points = math.prod(len(coordinates_m) for _, coordinates_m in grid)
    if n_points > MOST_POINTS:
        raise InvalidInput(
            f"--grid must have at most {MOST_POINTS} points; received {n_points} ({', '.join(axes)})"
        )
    coordinates_m = {"x": np.zeros(1), "y": np.zeros(1), "z": np.zeros(1), **dict(grid)}
    points_m = torch.from_numpy(
        np.stack(np.meshgrid(*coordinates_m.values(), indexing="ij"), axis=-1).reshape(-1, 3)
    )
    currents_A = named_number(currents, "--current")
    motion = {
        name: torch.tensor(values, dtype=torch.float64)
        for name, values in (named_numbers(text, "--motion", 6) for text in motions)
    }
    blocks = points_m.split(BLOCK)
    field = torch.cat([calibration.field(block, currents_A, motion) for block in blocks])
    intervals = [calibration.field_interval(block, currents_A, level, motion) for block in blocks]
    lower, upper = (torch.cat(ends) for ends in zip(*intervals, strict=True))
    is_inside = torch.isnan(field).any(dim=1)
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(HEADER)
    bounds = torch.stack((lower, upper), dim=-1).flatten(1)
    for row in range(len(points_m)):
        numbers = torch.cat((points_m[row], field[row], bounds[row])).tolist()
        writer.writerow(
            [f"{number:.9g}" if np.isfinite(number) else "" for number in numbers] + [int(is_inside[row])]
        )
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        write_text(out, buffer.getvalue())
    except OSError as error:
        raise InvalidInput(f"output must be writable; {out} is not: {reason(error)}") from error
    n_inside = int(is_inside.sum())
    text = f"{len(points_m)} points written to {out}" + (
        f"; {n_inside} lie inside a winding and are empty" if n_inside else ""
    )
    show(
        {"file": str(out), "points": len(points_m), "inside_winding": n_inside, "level": level}, text, as_json
    )


def _axis(text: str) -> tuple[str, np.ndarray]:
    """Parse an option --grid into the axis and its coordinates in metres."""
    import numpy as np

    from estimator.units import split_unit
    from estimator.yaml_section import LARGEST

    key, _, span = text.partition("=")
    name, unit = split_unit(key)
    parts = span.split(":")
    try:
        numbers = [float(part) for part in parts]
        count = int(parts[2]) if len(parts) == 3 else 1
    except ValueError:
        numbers, count = [], 0
    if (
        unit is None
        or unit.dimension != "length"
        or name not in ("x", "y", "z")
        or len(numbers) not in (1, 3)
        or count < 1
        or not np.isfinite(numbers).all()
    ):
        raise InvalidInput(f"--grid must look like x_mm=-50:50:11 or z_mm=20; received {text!r}")
    if count > MOST_POINTS or max(map(abs, numbers[:2])) > LARGEST:
        raise InvalidInput(
            f"--grid must have at most {MOST_POINTS} points within {LARGEST:g} of 0; received {text!r}"
        )
    return name, np.linspace(numbers[0], numbers[-2 if len(numbers) == 3 else 0], count) * unit.to_si
