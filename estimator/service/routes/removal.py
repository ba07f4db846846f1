"""Deletes jobs that have ended, and sessions that no job needs."""

from __future__ import annotations

from estimator.service.answers import row_of
from estimator.service.ownership import OWN_JOB, OWN_SESSION
from estimator.service.removal import remove_job, remove_session
from estimator.service.requests import ChangeOf, Id, router_of
from estimator.service.schema import Job, SessionRow

router = router_of("/v1")


@router.delete("/jobs/{job_id}", status_code=204, tags=["jobs"], dependencies=[OWN_JOB])
def delete_job(change: ChangeOf, job_id: Id) -> None:
    """Delete a job of one's own that has ended, or any with the scope admin, with its calibration; copies in a registry stay."""
    with change.core.database.writing() as db:
        remove_job(db, row_of(db, Job, job_id, "job"))
        change.note(db, "job.delete", job_id)
    change.core.remove_folder(job_id)


@router.delete("/sessions/{session_id}", status_code=204, tags=["sessions"], dependencies=[OWN_SESSION])
def delete_session(change: ChangeOf, session_id: Id) -> None:
    """Delete a session of one's own, open or closed, or any with the scope admin; jobs that worked with it have to be deleted first."""
    core = change.core
    with core.database.writing() as db:
        job_ids = remove_session(db, row_of(db, SessionRow, session_id, "session"), change.caller)
        change.note(db, "session.delete", session_id)
    core.sessions.remove(session_id)
    core.fits.forget(lambda known: known == session_id)
    core.watching.wake(session_id)
    for job_id in job_ids:
        core.remove_folder(job_id)
