"""A calibration in the formats of `coilcal export`, for other programs and languages."""

from __future__ import annotations

import math
import tempfile
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
from pydantic import BaseModel, Field
from starlette.responses import Response

from estimator.export.formats import FORMATS, default_path
from estimator.export.request import Grid
from estimator.service.core import Core
from estimator.service.problems import Problem
from estimator.service.readings import Number, Six
from estimator.service.requests import CoreOf, Id, router_of, turn
from estimator.service.routes.calibrations import calibration_of
from estimator.service.routes.predictions import MOST_COORDINATES, OfCoilsAlone

router = router_of("/v1/calibrations", "calibrations")
BYTES = "application/octet-stream"
FILE: dict[str, Any] = {
    "response_class": Response,
    "responses": {200: {"content": {BYTES: {"schema": {"type": "string", "format": "binary"}}}}},
}
WORDS = "; ".join(f"{name}: {chosen.words}" for name, chosen in FORMATS.items())


Coordinates = Annotated[list[Number], Field(min_length=1, max_length=MOST_COORDINATES)]


class ExportedGrid(BaseModel, extra="forbid", strict=True):
    """Ascending coordinates along the axes of the world frame, as `estimator.export.request.Grid`."""

    x_m: Coordinates
    y_m: Coordinates
    z_m: Coordinates


class ExportQuestion(BaseModel, extra="forbid", strict=True):
    """A format, and what it asks for beside the calibration."""

    to: Annotated[str, Field(description=WORDS, json_schema_extra={"enum": list(FORMATS)})]
    grid: Annotated[ExportedGrid | None, Field(description="Points, for formats that hold a field.")] = None
    currents_A: Annotated[
        dict[str, Number], Field(description="By coil, for formats that hold a field; others are off.")
    ] = {}
    motion: Annotated[
        dict[str, Six], Field(description="The six numbers of movers, in SI, where nothing moves.")
    ] = {}
    is_of_coils_alone: OfCoilsAlone = False


@router.post("/{calibration_id}/export", **FILE, dependencies=[turn("exporting")])
def export_calibration(core: CoreOf, calibration_id: Id, body: ExportQuestion) -> Response:
    """The calibrated model as a file for another program; the header Content-Disposition has its usual name."""
    if body.to not in FORMATS:
        raise Problem(422, "to", f"must be one of {', '.join(FORMATS)}", body.to, "body")
    calibration = calibration_of(core, calibration_id)[2]
    calibration = calibration.coils_alone() if body.is_of_coils_alone else calibration
    grid = None if body.grid is None else _grid_of(core, body.grid)
    motion = {name: torch.tensor(values, dtype=torch.float64) for name, values in body.motion.items()}
    with tempfile.TemporaryDirectory(dir=core.scratch()) as folder:
        path = Path(folder) / default_path(calibration.magnet(), body.to)
        calibration.export(body.to, path, grid=grid, currents_A=body.currents_A, motion=motion)
        name = {"Content-Disposition": f'attachment; filename="{path.name}"'}
        return Response(path.read_bytes(), headers=name, media_type=BYTES)


def _grid_of(core: Core, wanted: ExportedGrid) -> Grid:
    axes = {"x_m": wanted.x_m, "y_m": wanted.y_m, "z_m": wanted.z_m}
    n, most = math.prod(map(len, axes.values())), core.settings.most_grid_points
    if n > most:
        raise Problem(413, "grid", f"must have at most {most} points", n, "body")
    for name, coordinates_m in axes.items():
        if any(after <= before for before, after in pairwise(coordinates_m)):
            raise Problem(422, f"grid.{name}", "must ascend", place="body")
    return Grid(*(np.array(coordinates_m, dtype=np.float64) for coordinates_m in axes.values()))
