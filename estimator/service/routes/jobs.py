"""Jobs: followed, cancelled and read. Progress is in the file that a job's worker writes; a reader may go on where it left off."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, Literal

from fastapi import Depends, Header, Query, Request
from fastapi.sse import EventSourceResponse, ServerSentEvent
from pydantic import BaseModel, Field
from sqlalchemy import select
from starlette.concurrency import run_in_threadpool
from starlette.responses import HTMLResponse, JSONResponse, Response

from estimator.diagnosis.panel_records import Panels
from estimator.diagnosis.result import EXTENDED_RIG
from estimator.errors import CorruptStore, InvalidInput
from estimator.json_files import json_object, read_json
from estimator.service.answers import (
    UNCHANGED,
    ListingOf,
    Page,
    Search,
    page_with_etag,
    row_of,
    shown_as,
    with_etag,
)
from estimator.service.core import Core
from estimator.service.database import now
from estimator.service.job_queue import CANCELLED, DONE, ENDED, RETRY_AFTER_S
from estimator.service.labels import Labelled, Labels, containing, relabelled
from estimator.service.ownership import OWN_JOB
from estimator.service.problems import Problem
from estimator.service.requests import ID, STREAM, ChangeOf, CoreOf, Id, router_of
from estimator.service.schema import CalibrationRow, Job
from estimator.service.tasks import DIAGNOSIS, PANELS, TASKS
from estimator.service.webhooks import announce_end
from estimator.service.work import PROGRESS

router = router_of("/v1/jobs", "jobs")
LOOK_EVERY_S = 0.25
Kind = Literal["calibrate", "diagnose", "recalibrate", "batch", "design"]


class JobInfo(Labelled):
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


def job_of(core: Core, job_id: str) -> Job:
    """A job that must be there."""
    with core.database.reading() as db:
        return row_of(db, Job, job_id, "job")


@router.get("")
def list_jobs(
    listing: ListingOf,
    state: Annotated[Literal["queued", "running", "done", "failed", "cancelled"] | None, Query()] = None,
    session_id: Annotated[str | None, Query(pattern=ID)] = None,
    search: Search = None,
) -> Page[JobInfo]:
    """Jobs, newest first."""
    return listing.page(Job, JobInfo, *containing(Job, search), state=state, session_id=session_id)


@router.patch("/{job_id}", dependencies=[OWN_JOB])
def label_job(change: ChangeOf, job_id: Id, body: Labels) -> JobInfo:
    """Give a job of one's own a name, a note or tags."""
    return shown_as(JobInfo, relabelled(change, Job, job_id, "job", body))


@router.get("/{job_id}")
def get_job(core: CoreOf, job_id: Id) -> JobInfo:
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
def get_result(request: Request, core: CoreOf, job_id: Id) -> Response:
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
    result = read_json(folder / TASKS[job.kind].result, fault=CorruptStore)
    kind = shown_as(JobInfo, job).kind
    return JobResult(kind=kind, calibration_id=calibration, result=result, extended_rig=extended)


@router.get("/{job_id}/report", response_class=HTMLResponse, responses=UNCHANGED)
def get_report(request: Request, core: CoreOf, job_id: Id) -> Response:
    """The page of a job, one file without scripts; a design has none."""
    job = _done(core, job_id)
    report = TASKS[job.kind].report
    if report is None:
        raise Problem(404, "report", "must be of another kind of job; a design has none", place=job_id)
    path = core.jobs.folder(job_id) / report
    return page_with_etag(request, job_id, lambda: path.read_text(encoding="utf-8"))


@router.get("/{job_id}/panels", response_model=Panels, responses=UNCHANGED)
def get_panels(request: Request, core: CoreOf, job_id: Id) -> Response:
    """What the page shows of a diagnosis, as numbers: maps, hypotheses, shifts of parameters and plans."""
    job = _done(core, job_id)
    path = core.jobs.folder(job_id) / PANELS
    if job.kind != "diagnose" or not path.exists():
        raise Problem(409, "job", "must be a diagnosis that has panels", job.kind, job_id)
    content = path.read_bytes()
    return with_etag(request, f"{job_id}-panels", lambda: Response(content, media_type="application/json"))


@router.get("/{job_id}/events", response_class=EventSourceResponse, dependencies=[STREAM])
async def follow_job(
    core: CoreOf,
    first: Annotated[JobInfo, Depends(get_job)],
    last_event_id: Annotated[str | None, Header(alias="Last-Event-ID", max_length=20)] = None,
) -> AsyncIterator[ServerSentEvent]:
    """Progress of a job as server-sent events: `progress` as it works, and `end` with the job when it has ended."""
    job, lines = first, _Lines(core.jobs.folder(first.id) / PROGRESS)
    is_number = last_event_id and last_event_id.isascii() and last_event_id.isdecimal()
    n_known = int(last_event_id or 0) if is_number else 0
    while not core.is_ending:
        has_ended = job.state in ENDED  # asked before the file is read, so that no line is missed
        for number, line in await run_in_threadpool(lines.new):
            if number > n_known:
                yield ServerSentEvent(data=line, event="progress", id=str(number))
        if has_ended:
            yield ServerSentEvent(data=job, event="end")
            return
        await asyncio.sleep(LOOK_EVERY_S)
        job = await run_in_threadpool(get_job, core, first.id)


class _Lines:
    """Whole lines of a growing file, each with its number."""

    def __init__(self, path: Path) -> None:
        self._path, self._end, self._number = path, 0, 0

    def new(self) -> list[tuple[int, dict[str, Any]]]:
        """Lines since the last call; one that a kill has torn is left out, but counted."""
        try:
            with self._path.open("rb") as file:
                file.seek(self._end)
                *whole, _ = file.read().split(b"\n")
        except FileNotFoundError:
            return []
        entries = []
        for line in whole:
            self._end += len(line) + 1
            self._number += 1
            with suppress(InvalidInput):
                entries.append((self._number, json_object(line, self._path)))
        return entries


def _done(core: Core, job_id: str) -> Job:
    job = job_of(core, job_id)
    if job.state != DONE:
        headers = {} if job.state in ENDED else {"Retry-After": str(RETRY_AFTER_S)}
        raise Problem(409, "job", "must be done", job.state, job_id, headers)
    return job
