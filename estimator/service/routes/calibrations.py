"""Calibrations: what was found, with credible intervals, and as files."""

from __future__ import annotations

from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

from fastapi import Query, Request
from pydantic import BaseModel, Field
from sqlalchemy import select
from starlette.responses import HTMLResponse, JSONResponse, Response

from estimator.calibration.files import POSTERIOR_STORE, SUMMARY_FILE
from estimator.calibration.panels import CalibrationPanels, calibration_panels
from estimator.calibration.result import Calibration
from estimator.code_version import code_version
from estimator.comparison.calibrations import SideBySide, side_by_side
from estimator.comparison.calibrations_report import sentences, side_by_side_report
from estimator.rig_files.write import rig_text
from estimator.service.answers import (
    UNCHANGED,
    ListingOf,
    Page,
    file_of,
    file_with_etag,
    page_with_etag,
    row_of,
    shown_as,
    with_etag,
)
from estimator.service.core import Core
from estimator.service.requests import CoreOf, Id, router_of
from estimator.service.schema import CalibrationRow, Job
from estimator.service.tasks import TASKS
from estimator.store.zipped import zipped

router = router_of("/v1/calibrations", "calibrations")


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


def calibration_of(core: Core, calibration_id: str) -> tuple[CalibrationRow, Path, Calibration]:
    """A calibration that must be there, with its folder."""
    with core.database.reading() as db:
        row = row_of(db, CalibrationRow, calibration_id, "calibration")
        kind = db.scalars(select(Job.kind).where(Job.id == row.job_id)).one()
    folder = core.jobs.folder(row.job_id) / TASKS[kind].calibration
    return row, folder, core.calibration(folder)


@router.get("")
def list_calibrations(
    listing: ListingOf, rig_name: Annotated[str | None, Query(max_length=200)] = None
) -> Page[CalibrationInfo]:
    """Calibrations, newest first."""
    return listing.page(CalibrationRow, CalibrationInfo, rig_name=rig_name)


@router.get("/{calibration_id}")
def get_calibration(core: CoreOf, calibration_id: Id) -> CalibrationInfo:
    """One calibration."""
    return shown_as(CalibrationInfo, calibration_of(core, calibration_id)[0])


@router.get("/{calibration_id}/summary", response_model=dict[str, Any], responses=UNCHANGED)
def get_summary(request: Request, core: CoreOf, calibration_id: Id) -> Response:
    """The content of summary.json."""
    calibration = calibration_of(core, calibration_id)[2]
    return with_etag(request, calibration_id, lambda: JSONResponse(dict(calibration.summary())))


@router.get("/{calibration_id}/intervals", response_model=Intervals, responses=UNCHANGED)
def get_intervals(request: Request, core: CoreOf, calibration_id: Id) -> Response:
    """Credible intervals of every parameter."""
    calibration = calibration_of(core, calibration_id)[2]
    summary = calibration.summary()
    content = {"parameters": summary["parameters"], "best": dict(calibration.best)}
    intervals = Intervals.model_validate({**content, "is_converged": summary["is_converged"]})
    return with_etag(request, calibration_id, lambda: JSONResponse(intervals.model_dump()))


@router.get("/{calibration_id}/panels", response_model=CalibrationPanels, responses=UNCHANGED)
def get_panels(request: Request, core: CoreOf, calibration_id: Id) -> Response:
    """What the page shows of a calibration, as numbers: fields, what the data taught, residuals."""
    calibration = calibration_of(core, calibration_id)[2]
    return with_etag(
        request,
        f"{calibration_id}-panels-{version('coilcal')}-{code_version()}",
        lambda: JSONResponse(asdict(calibration_panels(calibration))),
    )


@router.get("/{calibration_id}/compare/{other_id}", response_model=dict[str, Any], responses=UNCHANGED)
def compare_calibrations(request: Request, core: CoreOf, calibration_id: Id, other_id: Id) -> Response:
    """Two calibrations side by side: sentences, numbers and the difference of the fields, as `coilcal compare --json` prints them."""

    def content() -> Response:
        compared = _side_by_side(core, calibration_id, other_id)
        return JSONResponse(compared.to_json() | {"sentences": sentences(compared)})

    return with_etag(request, f"{calibration_id}-{other_id}-{code_version()}", content)


@router.get("/{calibration_id}/compare/{other_id}/report", response_class=HTMLResponse, responses=UNCHANGED)
def get_comparison_report(request: Request, core: CoreOf, calibration_id: Id, other_id: Id) -> Response:
    """The page of two calibrations side by side, one file without scripts."""

    def page() -> str:
        return side_by_side_report(_side_by_side(core, calibration_id, other_id), request.url.path)

    return page_with_etag(request, f"{calibration_id}-{other_id}-page-{code_version()}", page)


def _side_by_side(core: Core, calibration_id: str, other_id: str) -> SideBySide:
    (first_row, _, first), (second_row, _, second) = (
        calibration_of(core, each) for each in (calibration_id, other_id)
    )
    names = [f"{row.created[:16].replace('T', ' ')} ({row.id[:8]})" for row in (first_row, second_row)]
    return side_by_side(first, second, (names[0], names[1]))


@router.get("/{calibration_id}/rig", **file_of("application/yaml", {"description": "A rig file."}))
def get_calibrated_rig(request: Request, core: CoreOf, calibration_id: Id) -> Response:
    """The rig that was fitted, as a rig file."""
    rig = calibration_of(core, calibration_id)[2].rig
    return with_etag(request, calibration_id, lambda: Response(rig_text(rig), media_type="application/yaml"))


@router.get("/{calibration_id}/calibration.zip", **file_of("application/zip"))
def download_calibration(request: Request, core: CoreOf, calibration_id: Id) -> Response:
    """The folder of a calibration as a zip, for `estimator.Calibration.load` and `coilcal predict`; its hashes seal it."""
    folder = calibration_of(core, calibration_id)[1]
    parts = POSTERIOR_STORE, SUMMARY_FILE
    return file_with_etag(
        request, calibration_id, lambda: zipped(folder, parts), "calibration.zip", "application/zip"
    )
