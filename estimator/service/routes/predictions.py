"""Field and gradient that follow from a calibration, at points or on a grid, with credible intervals; as JSON or as an Arrow stream."""

from __future__ import annotations

import math
from collections.abc import AsyncIterator, Mapping
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import torch
from pydantic import BaseModel, Field
from pydantic_core import to_json
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response, StreamingResponse
from torch import Tensor

from estimator.calibration import predictions
from estimator.export.labels import caution_of
from estimator.service.arrow import ARROW, arrow_stream
from estimator.service.core import Core
from estimator.service.predictions import BLOCK
from estimator.service.problems import Problem
from estimator.service.readings import Number, Six
from estimator.service.requests import CoreOf, Id, router_of
from estimator.service.routes.calibrations import calibration_of

router = router_of("/v1/calibrations", "calibrations")
Point = Annotated[list[Number], Field(min_length=3, max_length=3)]
Vector = list[float | None]
OfCoilsAlone = Annotated[
    bool, Field(description="Without what is there without current, such as the Earth's field.")
]
MOST_COORDINATES = 10_000  # of one axis
JSON = "application/json"
ARROW_RESPONSE: dict[str, Any] = {
    "response_class": StreamingResponse,
    "responses": {200: {"content": {ARROW: {"schema": {"type": "string", "format": "binary"}}}}},
}


class Wish(BaseModel, extra="forbid", strict=True):
    """What is asked for, wherever the points lie."""

    currents_A: Annotated[dict[str, Number], Field(description="By coil; coils that are not named are off.")]
    motion: Annotated[dict[str, Six], Field(description="The six numbers of movers, in SI.")] = {}
    level: Annotated[float, Field(gt=0, lt=1, description="Probability inside the intervals.")] = 0.9
    has_field: Annotated[bool, Field(description="Predict the field.")] = True
    has_gradient: Annotated[bool, Field(description="Predict the gradient dB_i / dx_j.")] = False
    has_intervals: Annotated[
        bool, Field(description="With credible intervals, from 400 evenly spaced draws of the posterior.")
    ] = True
    is_of_coils_alone: OfCoilsAlone = False


class PointsQuestion(Wish):
    """Points at which to predict."""

    points_m: Annotated[list[Point], Field(min_length=1, description="Points in the world frame.")]


class Axis(BaseModel, extra="forbid", strict=True):
    """Evenly spaced coordinates, both ends included."""

    first_m: Number
    last_m: Number
    n: Annotated[int, Field(ge=1, le=MOST_COORDINATES)]


class GridQuestion(Wish):
    """A regular grid in the world frame; an axis that is left out is at 0."""

    x: Axis = Axis(first_m=0.0, last_m=0.0, n=1)
    y: Axis = Axis(first_m=0.0, last_m=0.0, n=1)
    z: Axis = Axis(first_m=0.0, last_m=0.0, n=1)


class Prediction(BaseModel):
    """Field and gradient in the world frame; null at points inside a winding. What was not asked for is missing."""

    caution: Annotated[str | None, Field(description="Why the calibration is not good, where it is not.")] = (
        None
    )
    field_T: list[Vector] | None = None
    field_lower_T: list[Vector] | None = None
    field_upper_T: list[Vector] | None = None
    gradient_T_per_m: list[list[Vector]] | None = None
    gradient_lower_T_per_m: list[list[Vector]] | None = None
    gradient_upper_T_per_m: list[list[Vector]] | None = None


class GridPrediction(Prediction):
    """A prediction at the points of a grid, in the order in which z changes fastest and x slowest."""

    x_m: list[float]
    y_m: list[float]
    z_m: list[float]


@router.post("/{calibration_id}/predict", response_model=Prediction, response_model_exclude_none=True)
async def predict(core: CoreOf, calibration_id: Id, body: PointsQuestion) -> Response:
    """Field and gradient of the calibrated model at points."""
    asked = await run_in_threadpool(_asked, core, calibration_id, body)
    return await _as_json(_blocks(core, asked, _points_of(core, body), body), {}, asked)


@router.post("/{calibration_id}/predict.arrow", **ARROW_RESPONSE)
async def predict_arrow(core: CoreOf, calibration_id: Id, body: PointsQuestion) -> Response:
    """Field and gradient of the calibrated model at points, as an Arrow stream with a row for each point."""
    asked = await run_in_threadpool(_asked, core, calibration_id, body)
    return await _as_arrow(_blocks(core, asked, _points_of(core, body), body), calibration_id, body, asked)


@router.post("/{calibration_id}/grid", response_model=GridPrediction, response_model_exclude_none=True)
async def predict_grid(core: CoreOf, calibration_id: Id, body: GridQuestion) -> Response:
    """Field and gradient of the calibrated model on a regular grid."""
    axes, asked = _axes_of(core, body), await run_in_threadpool(_asked, core, calibration_id, body)
    return await _as_json(_blocks(core, asked, torch.cartesian_prod(*axes.values()), body), axes, asked)


@router.post("/{calibration_id}/grid.arrow", **ARROW_RESPONSE)
async def predict_grid_arrow(core: CoreOf, calibration_id: Id, body: GridQuestion) -> Response:
    """Field and gradient of the calibrated model on a regular grid, as an Arrow stream with a row for each point."""
    points_m = torch.cartesian_prod(*_axes_of(core, body).values())
    asked = await run_in_threadpool(_asked, core, calibration_id, body)
    return await _as_arrow(_blocks(core, asked, points_m, body), calibration_id, body, asked)


def _points_of(core: Core, body: PointsQuestion) -> Tensor:
    n, most = len(body.points_m), core.settings.most_points
    if n > most:
        raise Problem(413, "points_m", f"must have at most {most} points", n, "body")
    return torch.tensor(body.points_m, dtype=torch.float64)


def _axes_of(core: Core, body: GridQuestion) -> dict[str, Tensor]:
    axes = {"x_m": body.x, "y_m": body.y, "z_m": body.z}
    n, most = math.prod(axis.n for axis in axes.values()), core.settings.most_grid_points
    if n > most:
        raise Problem(413, "grid", f"must have at most {most} points", n, "body")
    return {
        name: torch.linspace(axis.first_m, axis.last_m, axis.n, dtype=torch.float64)
        for name, axis in axes.items()
    }


async def _blocks(
    core: Core, asked: Asked, points_m: Tensor, wish: Wish
) -> AsyncIterator[tuple[Tensor, Mapping[str, Tensor]]]:
    """What is predicted at some points after others, so that other questions pass between."""
    wanted = predictions.Wanted(wish.has_field, wish.has_gradient, wish.has_intervals, wish.is_of_coils_alone)
    motion = {name: torch.tensor(values, dtype=torch.float64) for name, values in wish.motion.items()}
    with core.predictor.limit.taken():
        for block in points_m.split(BLOCK):
            question = predictions.Question(block, wish.currents_A, motion, wish.level)
            yield block, await core.predictor.ask(asked.folder, question, wanted)


class Asked(NamedTuple):
    """A calibration that is asked: its folder, and why its intervals hold only under a condition; empty where it is good."""

    folder: Path
    caution: str


def _asked(core: Core, calibration_id: str, wish: Wish) -> Asked:
    """A calibration, which is in memory then, if its rig has what a question names."""
    _, folder, calibration = calibration_of(core, calibration_id)
    known = [mover.name for mover in calibration.rig.movers]
    for name in wish.motion:
        if name not in known:
            rule = f"must name movers of the rig ({', '.join(known) or 'none'})"
            raise Problem(422, "motion", rule, name, "body")
    return Asked(folder, caution_of(calibration))


async def _as_json(
    blocks: AsyncIterator[tuple[Tensor, Mapping[str, Tensor]]], axes: Mapping[str, Tensor], asked: Asked
) -> Response:
    answered = [answer async for _, answer in blocks]

    def body() -> bytes:
        joined = {name: torch.cat([answer[name] for answer in answered]) for name in answered[0]}
        content: dict[str, Any] = {n: values.tolist() for n, values in (*axes.items(), *joined.items())}
        content |= {"caution": asked.caution} if asked.caution else {}
        return to_json(content, inf_nan_mode="null")

    return Response(await run_in_threadpool(body), media_type=JSON)


async def _as_arrow(
    blocks: AsyncIterator[tuple[Tensor, Mapping[str, Tensor]]], calibration_id: str, wish: Wish, asked: Asked
) -> Response:
    about = {"calibration_id": calibration_id, "level": str(wish.level), "frame": "world"}
    about |= {"caution": asked.caution} if asked.caution else {}
    pieces = arrow_stream(blocks, about)
    first = await anext(pieces)  # a refusal comes before the answer begins

    async def stream() -> AsyncIterator[bytes]:
        yield first
        async for piece in pieces:
            yield piece

    return StreamingResponse(stream(), media_type=ARROW)
