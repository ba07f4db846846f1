"""Deletes jobs that have ended, and sessions that no job needs."""

from __future__ import annotations

from fastapi import APIRouter, Request
from sqlalchemy import select

from estimator.service.ownership import OWN_JOB, OWN_SESSION
from estimator.service.problems import not_found
from estimator.service.removal import remove_job, remove_session
from estimator.service.requests import CoreOf, Id, JsonRoute, Writer, audited
from estimator.service.schema import Job, SessionRow

router = APIRouter(route_class=JsonRoute, prefix="/v1")


@router.delete("/jobs/{job_id}", status_code=204, tags=["jobs"], dependencies=[OWN_JOB])
def delete_job(request: Request, core: CoreOf, caller: Writer, job_id: Id) -> None:
    """Delete a job of one's own that has ended, or any with the scope admin, with its calibration; copies in a registry stay."""
    with core.database.writing() as db:
        job = db.scalar(select(Job).where(Job.id == job_id))
        if job is None:
            raise not_found("job", job_id)
        remove_job(db, job)
        audited(db, request, caller, "job.delete", job_id)
    core.remove_folder(job_id)


@router.delete("/sessions/{session_id}", status_code=204, tags=["sessions"], dependencies=[OWN_SESSION])
def delete_session(request: Request, core: CoreOf, caller: Writer, session_id: Id) -> None:
    """Delete a session of one's own, open or closed, or any with the scope admin; jobs that worked with it have to be deleted first."""
    with core.database.writing() as db:
        session = db.get(SessionRow, session_id)
        if session is None:
            raise not_found("session", session_id)
        job_ids = remove_session(db, session, caller)
        audited(db, request, caller, "session.delete", session_id)
    core.sessions.remove(session_id)
    core.fits.forget(lambda known: known == session_id)
    core.watching.wake(session_id)
    for job_id in job_ids:
        core.remove_folder(job_id)
