"""`coilcal predict`: the field of a calibration with credible intervals, on a grid."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import click

from estimator.cli.grid import grid_axes, grid_words
from estimator.cli.named import named_motions, named_number
from estimator.cli.options import PATH, OutputPath, flag, option, prediction_options, result_options
from estimator.cli.output import CoilcalCommand, show

BLOCK = 50_000  # points predicted at once, with all draws of the posterior
HEADER = (
    ["x_m", "y_m", "z_m"]
    + [f"B{axis}_T" for axis in "xyz"]
    + [f"B{axis}_{end}_T" for axis in "xyz" for end in ("lower", "upper")]
    + ["inside_winding"]
)


@click.command("predict", cls=CoilcalCommand, takes_derivatives=False)
@click.argument("folder", metavar="CALIBRATION", type=PATH)
@option(
    "--grid axes",
    "Points along an axis of the world frame: x_mm=-50:50:11 is 11 of them, 10 mm apart. An axis left out is 0. Repeatable.",
    multiple=True,
    required=True,
    metavar="AXIS=FROM:TO:COUNT",
)
@option(
    "--current currents",
    "Current of a coil, such as coil1=3. Repeatable.",
    multiple=True,
    required=True,
    metavar="COIL=AMPERE",
)
@option(
    "--motion motions",
    "Pose of a mover: the six numbers of its columns, in SI units. Repeatable.",
    multiple=True,
    metavar="MOVER=V1,..,V6",
)
@option("--level", "Probability of the credible intervals.", float, default=0.9)
@flag(
    "--coils-alone",
    "Leave out what is there without current, such as the Earth's field. Where no sensor turned, intervals are wider with it.",
)
@option("--out", "CSV file to write.", OutputPath(), required=True)
@prediction_options("points")
@result_options
def predict_command(
    folder: Path,
    axes: tuple[str, ...],
    currents: tuple[str, ...],
    motions: tuple[str, ...],
    level: float,
    coils_alone: bool,
    out: Path,
    device: str,
    precision: str,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Write the field of CALIBRATION with credible intervals.

    Points lie on a grid in the world frame; the output is CSV. CALIBRATION is a folder written by `coilcal calibrate`.
    """
    import numpy as np

    from estimator.calibration.result import Calibration
    from estimator.cli.progress import COUNTED_EVERY_S, UNTOLD_S, Reporter
    from estimator.devices import device_named, precision_named
    from estimator.export.labels import caution_of
    from estimator.store.staging import check_output, staged
    from estimator.tensors import torch

    check_output(out, overwrite)
    there = {"device": device_named(device), "dtype": precision_named(precision)}
    calibration = Calibration.load(folder)
    if coils_alone:
        calibration = calibration.coils_alone()
    coordinates_m = grid_axes(axes)
    points_m = torch.from_numpy(
        np.stack(np.meshgrid(*coordinates_m.values(), indexing="ij"), axis=-1).reshape(-1, 3)
    )
    currents_A = named_number(currents, "--current")
    motion = named_motions(motions)
    n_inside = 0
    with (
        staged(out, overwrite) as new,
        new.open("w", encoding="utf-8", newline="") as file,
        Reporter(COUNTED_EVERY_S, UNTOLD_S, UNTOLD_S) as reporter,
    ):
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(HEADER)
        for n, block in enumerate(points_m.split(BLOCK)):
            reporter.count("predicting points", n * BLOCK, len(points_m))
            points = block.to(**there)
            best = calibration.field(points, currents_A, motion)
            ends = calibration.field_interval(points, currents_A, level, motion)
            field, *bounds = (values.to(block) for values in (best, *ends))
            is_inside = torch.isnan(field).any(dim=1)
            n_inside += int(is_inside.sum())
            table = torch.cat((block, field, torch.stack(bounds, dim=-1).flatten(1)), dim=1).tolist()
            writer.writerows(
                [*(f"{number:.9g}" if math.isfinite(number) else "" for number in numbers), int(inside)]
                for numbers, inside in zip(table, is_inside.tolist(), strict=True)
            )
    inside = f"; {n_inside} lie inside a winding and are empty" if n_inside else ""
    caution = caution_of(calibration)
    lines = [
        f"{len(points_m)} points written to {out}{inside}",
        grid_words(coordinates_m),
        *filter(None, [caution]),
    ]
    told = {"file": str(out), "points": len(points_m), "inside_winding": n_inside, "level": level}
    show({**told, "caution": caution}, "\n".join(lines), as_json)
