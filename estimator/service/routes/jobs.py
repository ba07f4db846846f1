"""Jobs: calibrations and diagnoses that are asked for, waited for, followed, cancelled and read."""

from __future__ import annotations

import json
from collections.abc import AsyncIterator
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, Header, Query, Request
from fastapi.sse import EventSourceResponse, ServerSentEvent
from pydantic import BaseModel, ConfigDict, Field
from sqlalchemy import select
from starlette.responses import HTMLResponse, Response

from estimator.calibration.result import SUMMARY_FILE
from estimator.diagnosis.panel_records import Panels
from estimator.diagnosis.result import DIAGNOSIS as DIAGNOSIS_FILE
from estimator.diagnosis.result import EXTENDED_RIG
from estimator.inference.ensemble import SamplerSettings
from estimator.rig_files.read import rig_from_text
from estimator.service.core import Core
from estimator.service.database import now
from estimator.service.events import events_of
from estimator.service.job_queue import CANCELLED, DONE, ENDED, RETRY_AFTER_S
from estimator.service.problems import Problem, not_found
from estimator.service.requests import (
    ID,
    CoreOf,
    Cursor,
    Id,
    Key,
    Limit,
    Page,
    Reader,
    StreamRoom,
    Writer,
    audited,
    page_of,
    with_etag,
)
from estimator.service.routes.sessions import closed_row_of
from estimator.service.schema import CalibrationRow, Job, RigVersion
from estimator.service.tokens import Scope
from estimator.service.webhooks import announce_end
from estimator.service.work import DIAGNOSIS, PANELS, REPORT, calibration_folder
from estimator.store.session import load_session

router = APIRouter(prefix="/v1/jobs", tags=["jobs"])
LARGEST_SEED = 2**32 - 1
PAGE_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; frame-ancestors 'none'; sandbox"
"""Of reports, which are one file with their style and pictures inside; nothing in them may run."""


class Sampling(BaseModel):
    """When to stop sampling; as `SamplerSettings`."""

    model_config = ConfigDict(extra="forbid")

    n_walkers: Annotated[int, Field(ge=0, le=2000)] = 0
    target_ess: Annotated[float, Field(gt=0, le=1e6, allow_inf_nan=False)] = SamplerSettings.target_ess
    largest_rhat: Annotated[float, Field(gt=1, le=10, allow_inf_nan=False)] = SamplerSettings.largest_rhat
    max_steps: Annotated[int, Field(ge=1, le=1_000_000)] = SamplerSettings.max_steps
    check_every: Annotated[int, Field(ge=1, le=10_000)] = SamplerSettings.check_every


class NewJob(BaseModel):
    """What every job has."""

    model_config = ConfigDict(extra="forbid")

    session_id: Annotated[str, Field(pattern=ID, description="A closed session.")]
    rig_id: Annotated[
        str | None,
        Field(pattern=ID, description="Another description of the session's rig; its own where left out."),
    ] = None
    seed: Annotated[int, Field(ge=0, le=LARGEST_SEED, description="Of everything random.")] = 0


class NewCalibration(NewJob):
    """A calibration to make."""

    settings: Sampling = Sampling()
    has_integer_counts: Annotated[bool, Field(description="Treat free loop counts as whole numbers.")] = True


class NewDiagnosis(NewJob):
    """A diagnosis to make."""

    has_posterior: Annotated[bool, Field(description="Sample the posterior of the extended rig.")] = False
    minutes: Annotated[
        float | None, Field(gt=0, le=1e5, allow_inf_nan=False, description="Time for the search.")
    ] = None
    most_causes: Annotated[int | None, Field(ge=0, le=50)] = None
    most_readings: Annotated[int | None, Field(ge=20, le=100_000)] = None


class JobInfo(BaseModel):
    """A job; `fault` is the sentence that says why it failed."""

    id: str
    kind: Literal["calibrate", "diagnose"]
    state: Literal["queued", "running", "done", "failed", "cancelled"]
    session_id: str
    rig_id: str | None
    options: dict[str, Any]
    created: str
    started: str | None
    ended: str | None
    user: str
    starts: Annotated[
        int, Field(description="How often it was begun; above 1 where the service or a worker was killed.")
    ]
    fault: str | None


class JobResult(BaseModel):
    """What a job has found: `summary.json` or `diagnosis.json`, and the id of the calibration that it made."""

    kind: Literal["calibrate", "diagnose"]
    calibration_id: str | None
    result: dict[str, Any]
    extended_rig: Annotated[str | None, Field(description="Of a diagnosis: text of rig_extended.yaml.")]


KNOWN: dict[int | str, dict[str, Any]] = {200: {"model": JobInfo, "description": "The key was used before."}}


def info_of(row: Job) -> JobInfo:
    """A row as the API shows it."""
    return JobInfo.model_validate(row, from_attributes=True)


def job_of(core: Core, job_id: str) -> Job:
    """A job that must be there."""
    with core.database.reading() as db:
        row = db.scalar(select(Job).where(Job.id == job_id))
    if row is None:
        raise not_found("job", job_id)
    return row


@router.post("/calibrate", status_code=201, responses=KNOWN)
def calibrate(
    request: Request, response: Response, core: CoreOf, caller: Writer, body: NewCalibration, key: Key = None
) -> JobInfo:
    """Queue a calibration: point estimate, posterior, model."""
    options = {"seed": body.seed, **body.model_dump(include={"settings", "has_integer_counts"})}
    return _queued(request, response, core, caller.user, "calibrate", body, options, key)


@router.post("/diagnose", status_code=201, responses=KNOWN)
def diagnose(
    request: Request, response: Response, core: CoreOf, caller: Writer, body: NewDiagnosis, key: Key = None
) -> JobInfo:
    """Queue a diagnosis: what the simulation gets wrong, named, and the rig extended by it."""
    limits = {"has_posterior", "minutes", "most_causes", "most_readings"}
    options = {"seed": body.seed, **body.model_dump(include=limits)}
    return _queued(request, response, core, caller.user, "diagnose", body, options, key)


def _queued(
    request: Request,
    response: Response,
    core: Core,
    user: str,
    kind: str,
    body: NewJob,
    options: dict[str, Any],
    key: str | None,
) -> JobInfo:
    session = closed_row_of(core, body.session_id)
    if body.rig_id is not None:
        with core.database.reading() as db:
            version = db.get(RigVersion, body.rig_id)
        if version is None:
            raise not_found("rig", body.rig_id)
        load_session(core.sessions.path(session.id)).check_rig(rig_from_text(version.text, "rig"))
    asked = {
        "kind": kind,
        "user": user,
        "session_id": body.session_id,
        "rig_id": body.rig_id,
        "options": options,
        "idempotency_key": key,
    }
    with core.database.writing() as db:
        job, is_new = core.queue.add(db, asked)
        if is_new:
            audited(db, request, request.scope["caller"], f"job.{kind}", job.id)
        else:
            response.status_code = 200
    core.jobs.wake()
    return info_of(job)


@router.get("")
def list_jobs(
    core: CoreOf,
    caller: Reader,  # noqa: ARG001
    limit: Limit = 50,
    cursor: Cursor = None,
    state: Annotated[Literal["queued", "running", "done", "failed", "cancelled"] | None, Query()] = None,
    session_id: Annotated[str | None, Query(pattern=ID)] = None,
) -> Page[JobInfo]:
    """Jobs, newest first."""
    rows = select(Job)
    if state is not None:
        rows = rows.where(Job.state == state)
    if session_id is not None:
        rows = rows.where(Job.session_id == session_id)
    with core.database.reading() as db:
        return page_of(db, rows, Job, limit, cursor, info_of)


@router.get("/{job_id}")
def get_job(core: CoreOf, caller: Reader, job_id: Id) -> JobInfo:  # noqa: ARG001
    """One job."""
    return info_of(job_of(core, job_id))


@router.post("/{job_id}/cancel")
def cancel_job(request: Request, core: CoreOf, caller: Writer, job_id: Id) -> JobInfo:
    """End a job of one's own, or any with the scope admin; one that has ended stays as it is."""
    with core.database.writing() as db:
        row = db.scalar(select(Job).where(Job.id == job_id))
        if row is None:
            raise not_found("job", job_id)
        if row.user != caller.user and not caller.scope.includes(Scope.ADMIN):
            raise Problem(403, "job", "must be one's own, unless the token has the scope admin", job_id)
        if row.state not in ENDED:
            row.state, row.ended = CANCELLED, now()
            announce_end(db, row)
            audited(db, request, caller, "job.cancel", job_id)
    core.jobs.wake()
    return info_of(row)


@router.get("/{job_id}/result")
def get_result(core: CoreOf, caller: Reader, job_id: Id) -> JobResult:  # noqa: ARG001
    """What a job has found."""
    job = _done(core, job_id)
    folder = core.jobs.folder(job_id)
    with core.database.reading() as db:
        calibration = db.scalar(select(CalibrationRow.id).where(CalibrationRow.job_id == job_id))
    extended = None
    if job.kind == "diagnose":
        path = folder / DIAGNOSIS / DIAGNOSIS_FILE
        extended = (folder / DIAGNOSIS / EXTENDED_RIG).read_text(encoding="utf-8")
    else:
        path = calibration_folder(job.kind, folder) / SUMMARY_FILE
    result = json.loads(path.read_text(encoding="utf-8"))
    return JobResult(kind=info_of(job).kind, calibration_id=calibration, result=result, extended_rig=extended)


@router.get(
    "/{job_id}/report",
    response_class=HTMLResponse,
    responses={304: {"description": "It has not changed."}},
)
def get_report(request: Request, core: CoreOf, caller: Reader, job_id: Id) -> Response:  # noqa: ARG001
    """The page of a calibration or diagnosis, one file without scripts."""
    job = _done(core, job_id)
    folder = core.jobs.folder(job_id)
    path = (calibration_folder(job.kind, folder) if job.kind == "calibrate" else folder / DIAGNOSIS) / REPORT
    answer = with_etag(request, job_id, lambda: HTMLResponse(path.read_text(encoding="utf-8")))
    answer.headers["Content-Security-Policy"] = (
        PAGE_POLICY  # on 304 too, whose headers replace those of the copy
    )
    return answer


@router.get("/{job_id}/panels", responses={304: {"description": "They have not changed."}})
def get_panels(request: Request, core: CoreOf, caller: Reader, job_id: Id) -> Panels:  # noqa: ARG001
    """What the page shows of a diagnosis, as numbers: maps, hypotheses, shifts of parameters and plans."""
    job = _done(core, job_id)
    path = core.jobs.folder(job_id) / DIAGNOSIS / PANELS
    if job.kind != "diagnose" or not path.exists():
        raise Problem(409, "job", "must be a diagnosis that has panels", job.kind, job_id)
    content = path.read_bytes()
    return with_etag(request, f"{job_id}-panels", lambda: Response(content, media_type="application/json"))  # type: ignore[return-value]


@router.get("/{job_id}/events", response_class=EventSourceResponse)
async def follow_job(
    core: CoreOf,
    caller: Reader,  # noqa: ARG001
    room: StreamRoom,  # noqa: ARG001
    first: Annotated[JobInfo, Depends(get_job)],
    last_event_id: Annotated[str | None, Header(alias="Last-Event-ID", max_length=20)] = None,
) -> AsyncIterator[ServerSentEvent]:
    """Progress of a job as server-sent events: `progress` as it works, and `end` with the job when it has ended."""
    async for event in events_of(core, first.id, last_event_id, lambda: info_of(job_of(core, first.id))):
        yield event


def _done(core: Core, job_id: str) -> Job:
    job = job_of(core, job_id)
    if job.state != DONE:
        headers = {} if job.state in ENDED else {"Retry-After": str(RETRY_AFTER_S)}
        raise Problem(409, "job", "must be done", job.state, job_id, headers)
    return job
