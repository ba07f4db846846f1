"""Calibrations: what was found, and the field that follows from it, with credible intervals."""

from __future__ import annotations

import math
from typing import Annotated, Any

import torch
from fastapi import APIRouter, Query, Request
from pydantic import BaseModel, ConfigDict, Field
from sqlalchemy import select
from starlette.responses import JSONResponse, Response

from estimator.calibration.result import Calibration
from estimator.rig_files.write import rig_text
from estimator.service.core import Core
from estimator.service.problems import Problem, not_found
from estimator.service.readings import Number, Six
from estimator.service.requests import CoreOf, Cursor, Id, Limit, Page, Reader, page_of, with_etag
from estimator.service.schema import CalibrationRow, Job
from estimator.service.work import calibration_folder

router = APIRouter(prefix="/v1/calibrations", tags=["calibrations"])
BLOCK = 2_000  # points predicted at once, with all draws of the posterior
Point = Annotated[list[Number], Field(min_length=3, max_length=3)]
Vector = list[float | None]


class CalibrationInfo(BaseModel):
    """A calibration and where it comes from."""

    id: str
    job_id: str
    session_id: str
    rig_name: str
    created: str
    user: str


class Interval(BaseModel):
    """What is known of one parameter."""

    median: float
    sd: float
    ci90: Annotated[list[float], Field(min_length=2, max_length=2)]
    unit: str


class Intervals(BaseModel):
    """Credible intervals of all parameters, and every number of the rig at the posterior's maximum."""

    parameters: dict[str, Interval]
    best: dict[str, float]
    is_converged: bool


class Question(BaseModel):
    """Points at which to predict."""

    model_config = ConfigDict(extra="forbid", strict=True)

    points_m: Annotated[list[Point], Field(min_length=1, description="Points in the world frame.")]
    currents_A: Annotated[dict[str, Number], Field(description="By coil; coils that are not named are off.")]
    motion: Annotated[dict[str, Six], Field(description="The six numbers of movers, in SI.")] = {}
    level: Annotated[float, Field(gt=0, lt=1, description="Probability inside the intervals.")] = 0.9
    has_field: Annotated[bool, Field(description="Predict the field.")] = True
    has_gradient: Annotated[bool, Field(description="Predict the gradient dB_i / dx_j.")] = False
    has_intervals: Annotated[bool, Field(description="With credible intervals.")] = True


class Prediction(BaseModel):
    """Field and gradient in the world frame; null at points inside a winding, and what was not asked for is null as a whole."""

    field_T: list[Vector] | None = None
    field_lower_T: list[Vector] | None = None
    field_upper_T: list[Vector] | None = None
    gradient_T_per_m: list[list[Vector]] | None = None
    gradient_lower_T_per_m: list[list[Vector]] | None = None
    gradient_upper_T_per_m: list[list[Vector]] | None = None


def info_of(row: CalibrationRow) -> CalibrationInfo:
    """A row as the API shows it."""
    return CalibrationInfo.model_validate(row, from_attributes=True)


def calibration_of(core: Core, calibration_id: str) -> tuple[CalibrationRow, Calibration]:
    """A calibration that must be there."""
    with core.database.reading() as db:
        row = db.get(CalibrationRow, calibration_id)
        kind = None if row is None else db.scalar(select(Job.kind).where(Job.id == row.job_id))
    if row is None or kind is None:
        raise not_found("calibration", calibration_id)
    return row, core.calibration(calibration_folder(kind, core.jobs.folder(row.job_id)))


@router.get("")
def list_calibrations(
    core: CoreOf,
    caller: Reader,  # noqa: ARG001
    limit: Limit = 50,
    cursor: Cursor = None,
    rig_name: Annotated[str | None, Query(max_length=200)] = None,
) -> Page[CalibrationInfo]:
    """Calibrations, newest first."""
    rows = select(CalibrationRow)
    if rig_name is not None:
        rows = rows.where(CalibrationRow.rig_name == rig_name)
    with core.database.reading() as db:
        return page_of(db, rows, CalibrationRow, limit, cursor, info_of)


@router.get("/{calibration_id}")
def get_calibration(core: CoreOf, caller: Reader, calibration_id: Id) -> CalibrationInfo:  # noqa: ARG001
    """One calibration."""
    return info_of(calibration_of(core, calibration_id)[0])


@router.get("/{calibration_id}/summary", responses={304: {"description": "It has not changed."}})
def get_summary(request: Request, core: CoreOf, caller: Reader, calibration_id: Id) -> dict[str, Any]:  # noqa: ARG001
    """The content of summary.json."""
    calibration = calibration_of(core, calibration_id)[1]
    return with_etag(request, calibration_id, lambda: JSONResponse(dict(calibration.summary())))  # type: ignore[return-value]


@router.get("/{calibration_id}/intervals")
def get_intervals(core: CoreOf, caller: Reader, calibration_id: Id) -> Intervals:  # noqa: ARG001
    """Credible intervals of every parameter."""
    calibration = calibration_of(core, calibration_id)[1]
    summary = calibration.summary()
    return Intervals.model_validate(
        {
            "parameters": summary["parameters"],
            "best": dict(calibration.best),
            "is_converged": summary["is_converged"],
        }
    )


@router.get(
    "/{calibration_id}/rig",
    response_class=Response,
    responses={200: {"content": {"application/yaml": {"schema": {"description": "A rig file."}}}}},
)
def get_calibrated_rig(core: CoreOf, caller: Reader, calibration_id: Id) -> Response:  # noqa: ARG001
    """The rig that was fitted, as a rig file."""
    return Response(rig_text(calibration_of(core, calibration_id)[1].rig), media_type="application/yaml")


@router.post("/{calibration_id}/predict")
def predict(core: CoreOf, caller: Reader, calibration_id: Id, body: Question) -> Prediction:  # noqa: ARG001
    """Field and gradient of the calibrated model at points."""
    n, most = len(body.points_m), core.settings.most_points
    if n > most:
        raise Problem(413, "points_m", f"must have at most {most} points", n, "body")
    calibration = calibration_of(core, calibration_id)[1]
    points_m = torch.tensor(body.points_m, dtype=torch.float64)
    motion = {name: torch.tensor(values, dtype=torch.float64) for name, values in body.motion.items()}
    known = [mover.name for mover in calibration.rig.movers]
    for name in motion:
        if name not in known:
            raise Problem(
                422, "motion", f"must name movers of the rig ({', '.join(known) or 'none'})", name, "body"
            )
    answers: dict[str, list[Any]] = {}

    def add(**parts: torch.Tensor) -> None:
        for name, part in parts.items():
            answers.setdefault(name, []).extend(_nulls(part.tolist()))

    for block in points_m.split(BLOCK):
        asked = (block, body.currents_A)
        if body.has_field:
            add(field_T=calibration.field(*asked, motion))
        if body.has_field and body.has_intervals:
            lower, upper = calibration.field_interval(*asked, body.level, motion)
            add(field_lower_T=lower, field_upper_T=upper)
        if body.has_gradient:
            add(gradient_T_per_m=calibration.gradient(*asked, motion))
        if body.has_gradient and body.has_intervals:
            lower, upper = calibration.gradient_interval(*asked, body.level, motion)
            add(gradient_lower_T_per_m=lower, gradient_upper_T_per_m=upper)
    return Prediction(**answers)


def _nulls(values: Any) -> Any:
    """Numbers in nested lists, None in place of NaN."""
    if isinstance(values, list):
        return [_nulls(value) for value in values]
    return values if math.isfinite(values) else None
