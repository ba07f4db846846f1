"""Jobs: work that is asked for, waited for, followed, cancelled and read."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, Header, Query, Request
from fastapi.sse import EventSourceResponse, ServerSentEvent
from pydantic import BaseModel, ConfigDict, Field
from sqlalchemy import select
from starlette.responses import HTMLResponse, JSONResponse, Response

from estimator.diagnosis.panel_records import Panels
from estimator.diagnosis.result import EXTENDED_RIG
from estimator.errors import CorruptStore
from estimator.inference.ensemble import SamplerSettings
from estimator.json_files import read_json
from estimator.rig_files.read import rig_from_text
from estimator.service.core import Core
from estimator.service.database import now
from estimator.service.events import events_of
from estimator.service.job_queue import CANCELLED, DONE, ENDED, RETRY_AFTER_S
from estimator.service.ownership import OWN_JOB, check_registry
from estimator.service.problems import Problem
from estimator.service.requests import (
    ID,
    UNCHANGED,
    ChangeOf,
    CoreOf,
    Id,
    JsonRoute,
    Key,
    ListingOf,
    Page,
    Reader,
    Seed,
    StreamRoom,
    row_of,
    shown_as,
    with_etag,
)
from estimator.service.routes.rigs import rig_row_of
from estimator.service.routes.sessions import closed_row_of
from estimator.service.schema import CalibrationRow, Job
from estimator.service.webhooks import announce_end
from estimator.service.work import DIAGNOSIS, PANELS, report_file, result_file
from estimator.store.session import load_session

router = APIRouter(route_class=JsonRoute, prefix="/v1/jobs", tags=["jobs"])
MOST_SESSIONS = 200  # of a batch
PAGE_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; frame-ancestors 'none'; sandbox"
"""Content-Security-Policy of reports, which are one file with their style and pictures inside; nothing in them may run."""


Kind = Literal["calibrate", "diagnose", "recalibrate", "batch", "design"]
SessionId = Annotated[str, Field(pattern=ID, description="A closed session.")]
RigId = Annotated[
    str | None,
    Field(pattern=ID, description="Another description of the session's rig; its own where left out."),
]
AsDescribed = Annotated[
    bool,
    Field(
        description="Leave out a field of the room and a zero of each sensor that the rig does not mention."
    ),
]
Word = Annotated[str, Field(min_length=1, max_length=200)]


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

    rig_id: RigId = None


class NewFit(NewJob):
    """A job with one session."""

    session_id: SessionId
    seed: Seed = 0


class NewCalibration(NewFit):
    """A calibration to make."""

    settings: Sampling = Sampling()
    has_integer_counts: Annotated[bool, Field(description="Treat free loop counts as whole numbers.")] = True
    as_described: AsDescribed = False


class NewDiagnosis(NewFit):
    """A diagnosis to make."""

    has_posterior: Annotated[bool, Field(description="Sample the posterior of the extended rig.")] = False
    has_corrections: Annotated[
        bool, Field(description="Correct predictions by what is left without a name.")
    ] = True
    minutes: Annotated[
        float | None, Field(gt=0, le=1e5, allow_inf_nan=False, description="Time for the search.")
    ] = None
    most_causes: Annotated[int | None, Field(ge=0, le=50)] = None
    most_readings: Annotated[int | None, Field(ge=20, le=100_000)] = None


class NewRecalibration(NewFit):
    """A session to judge against the current version of its rig's registry."""

    settings: Sampling = Sampling()


class NewDesign(NewJob):
    """Readings to propose after a session, with one of three aims."""

    session_id: SessionId
    split: Annotated[list[Word], Field(max_length=20, description="Causes to be told apart.")] = []
    shrink: Annotated[Word | None, Field(description="Parameter whose interval is to shrink.")] = None
    correction: Annotated[Word | None, Field(description="Correction to be determined by a map.")] = None
    degree: Annotated[int, Field(ge=1, le=5, description="Highest degree of the correction's terms.")] = 3
    n_readings: Annotated[int, Field(ge=1, le=500)] = 20


class NewBatch(NewJob):
    """Sessions to fit under several hypotheses."""

    session_ids: Annotated[
        list[Annotated[str, Field(pattern=ID)]],
        Field(min_length=1, max_length=MOST_SESSIONS, description="Closed sessions."),
    ]
    seed: Seed = 0
    hypotheses: Annotated[
        list[Word],
        Field(
            min_length=1,
            max_length=50,
            description="`plain` for the rig as described, or causes that are free in addition, joined by +.",
        ),
    ] = ["plain"]
    is_each_coil: Annotated[bool, Field(description="Calibrate each coil by itself.")] = False
    has_posterior: Annotated[bool, Field(description="Sample the probable hypotheses.")] = True
    as_described: AsDescribed = False
    settings: Sampling = Sampling()


class JobInfo(BaseModel):
    """A job; `fault` is the sentence that says why it failed."""

    id: str
    kind: Kind
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
    """What a job has found, and the id of the calibration that it made.

    `result` is `summary.json` of a calibration, `diagnosis.json` of a diagnosis, the entry of the registry of a recalibration, `fits` and
    `failed` of a batch, and of a design what `coilcal design --json` prints, with the text of the plan.
    """

    kind: Kind
    calibration_id: str | None
    result: dict[str, Any]
    extended_rig: Annotated[str | None, Field(description="Of a diagnosis: text of rig_extended.yaml.")]


KNOWN: dict[int | str, dict[str, Any]] = {200: {"model": JobInfo, "description": "The key was used before."}}


def job_of(core: Core, job_id: str) -> Job:
    """A job that must be there."""
    with core.database.reading() as db:
        return row_of(db, Job, job_id, "job")


class Submission:
    """What a request for a job comes with besides its body: who asks, and the key that makes a repeated request the same job.

    Args:
        change: The call.
        response: Its answer.
        key: Given by the client.
    """

    def __init__(self, change: ChangeOf, response: Response, key: Key = None) -> None:
        self._change, self._response, self._key = change, response, key
        self.core, self.caller = change.core, change.caller

    def queue(self, kind: Kind, session_ids: list[str], body: NewJob, **more: Any) -> JobInfo:
        """Queue a job on closed sessions; one with the same key that is there already is given back.

        Args:
            kind: What it does.
            session_ids: With which sessions.
            body: All that was asked for. What is neither a session nor the rig is an option of the job.
            more: Options beside.
        """
        core, rig_id = self.core, body.rig_id
        sessions = [closed_row_of(core, session_id) for session_id in session_ids]
        if rig_id is not None:
            rig = rig_from_text(rig_row_of(core, rig_id).text, "rig")
            for session in sessions:
                load_session(core.sessions.path(session.id)).check_rig(rig)
        asked = {
            "kind": kind,
            "user": self.caller.user,
            "session_id": session_ids[0],
            "rig_id": rig_id,
            "options": {**more, **body.model_dump(exclude={"session_id", "rig_id"})},
            "idempotency_key": self._key,
        }
        with core.database.writing() as db:
            job, is_new = core.queue.add(db, asked)
            if is_new:
                self._change.note(db, f"job.{kind}", job.id)
            else:
                self._response.status_code = 200
        core.jobs.wake()
        return shown_as(JobInfo, job)


Submitted = Annotated[Submission, Depends()]


@router.post("/calibrate", status_code=201, responses=KNOWN)
def calibrate(submission: Submitted, body: NewCalibration) -> JobInfo:
    """Queue a calibration: point estimate, posterior, model."""
    return submission.queue("calibrate", [body.session_id], body)


@router.post("/diagnose", status_code=201, responses=KNOWN)
def diagnose(submission: Submitted, body: NewDiagnosis) -> JobInfo:
    """Queue a diagnosis: what the simulation gets wrong, named, and the rig extended by it."""
    return submission.queue("diagnose", [body.session_id], body)


@router.post("/recalibrate", status_code=201, responses=KNOWN)
def recalibrate(submission: Submitted, body: NewRecalibration) -> JobInfo:
    """Queue the judgement of a session in the registry of a rig of one's own: does the current version hold, and what replaces it."""
    session = closed_row_of(submission.core, body.session_id)
    version = rig_row_of(submission.core, body.rig_id or session.rig_id)
    check_registry(submission.core, submission.caller, version.name)
    return submission.queue("recalibrate", [body.session_id], body, registry=version.name)


@router.post("/batch", status_code=201, responses=KNOWN)
def batch(submission: Submitted, body: NewBatch) -> JobInfo:
    """Queue the calibration of many sessions, with the probabilities of the hypotheses."""
    return submission.queue("batch", body.session_ids, body)


@router.post("/design", status_code=201, responses=KNOWN)
def design(submission: Submitted, body: NewDesign) -> JobInfo:
    """Queue a proposal of the next readings: to tell causes apart, to shrink an interval, or to map a correction."""
    return submission.queue("design", [body.session_id], body)


@router.get("")
def list_jobs(
    caller: Reader,  # noqa: ARG001
    listing: ListingOf,
    state: Annotated[Literal["queued", "running", "done", "failed", "cancelled"] | None, Query()] = None,
    session_id: Annotated[str | None, Query(pattern=ID)] = None,
) -> Page[JobInfo]:
    """Jobs, newest first."""
    return listing.page(Job, JobInfo, state=state, session_id=session_id)


@router.get("/{job_id}")
def get_job(core: CoreOf, caller: Reader, job_id: Id) -> JobInfo:  # noqa: ARG001
    """One job."""
    return shown_as(JobInfo, job_of(core, job_id))


@router.post("/{job_id}/cancel", dependencies=[OWN_JOB])
def cancel_job(change: ChangeOf, job_id: Id) -> JobInfo:
    """End a job of one's own, or any with the scope admin; one that has ended stays as it is."""
    with change.core.database.writing() as db:
        row = row_of(db, Job, job_id, "job")
        if row.state not in ENDED:
            row.state, row.ended = CANCELLED, now()
            announce_end(db, row)
            change.note(db, "job.cancel", job_id)
    change.core.jobs.wake()
    return shown_as(JobInfo, row)


@router.get("/{job_id}/result", response_model=JobResult, responses=UNCHANGED)
def get_result(request: Request, core: CoreOf, caller: Reader, job_id: Id) -> Response:  # noqa: ARG001
    """What a job has found."""
    job = _done(core, job_id)
    return with_etag(request, job_id, lambda: JSONResponse(_result_of(core, job).model_dump()))


def _result_of(core: Core, job: Job) -> JobResult:
    folder = core.jobs.folder(job.id)
    with core.database.reading() as db:
        calibration = db.scalar(select(CalibrationRow.id).where(CalibrationRow.job_id == job.id))
    extended = None
    if job.kind == "diagnose":
        extended = (folder / DIAGNOSIS / EXTENDED_RIG).read_text(encoding="utf-8")
    result = read_json(result_file(job.kind, folder), fault=CorruptStore)
    kind = shown_as(JobInfo, job).kind
    return JobResult(kind=kind, calibration_id=calibration, result=result, extended_rig=extended)


@router.get("/{job_id}/report", response_class=HTMLResponse, responses=UNCHANGED)
def get_report(request: Request, core: CoreOf, caller: Reader, job_id: Id) -> Response:  # noqa: ARG001
    """The page of a job, one file without scripts; a design has none."""
    job = _done(core, job_id)
    if job.kind == "design":
        raise Problem(404, "report", "must be of another kind of job; a design has none", place=job_id)
    path = report_file(job.kind, core.jobs.folder(job_id))
    answer = with_etag(request, job_id, lambda: HTMLResponse(path.read_text(encoding="utf-8")))
    # On 304 too, whose headers replace those of the copy.
    answer.headers["Content-Security-Policy"] = PAGE_POLICY
    return answer


@router.get("/{job_id}/panels", response_model=Panels, responses=UNCHANGED)
def get_panels(request: Request, core: CoreOf, caller: Reader, job_id: Id) -> Response:  # noqa: ARG001
    """What the page shows of a diagnosis, as numbers: maps, hypotheses, shifts of parameters and plans."""
    job = _done(core, job_id)
    path = core.jobs.folder(job_id) / DIAGNOSIS / PANELS
    if job.kind != "diagnose" or not path.exists():
        raise Problem(409, "job", "must be a diagnosis that has panels", job.kind, job_id)
    content = path.read_bytes()
    return with_etag(request, f"{job_id}-panels", lambda: Response(content, media_type="application/json"))


@router.get("/{job_id}/events", response_class=EventSourceResponse)
async def follow_job(
    core: CoreOf,
    caller: Reader,  # noqa: ARG001
    room: StreamRoom,  # noqa: ARG001
    first: Annotated[JobInfo, Depends(get_job)],
    last_event_id: Annotated[str | None, Header(alias="Last-Event-ID", max_length=20)] = None,
) -> AsyncIterator[ServerSentEvent]:
    """Progress of a job as server-sent events: `progress` as it works, and `end` with the job when it has ended."""
    async for event in events_of(
        core, first.id, last_event_id, lambda: shown_as(JobInfo, job_of(core, first.id))
    ):
        yield event


def _done(core: Core, job_id: str) -> Job:
    job = job_of(core, job_id)
    if job.state != DONE:
        headers = {} if job.state in ENDED else {"Retry-After": str(RETRY_AFTER_S)}
        raise Problem(409, "job", "must be done", job.state, job_id, headers)
    return job
