"""Deletion: of jobs and sessions on request, and of jobs that ended long ago where the settings say so.

A row goes first and its folder after it, so a kill in between leaves a folder without a row, which the next start removes.
Judgements of sessions stay as long as their session: without them a schedule would judge it again.
"""

from __future__ import annotations

import logging
import shutil
from collections.abc import Callable, Iterable, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

from sqlalchemy import delete, select
from sqlalchemy.orm import Session

from estimator.errors import listed
from estimator.service.database import Database
from estimator.service.job_queue import ENDED
from estimator.service.problems import Problem
from estimator.service.schedules import RECALIBRATE
from estimator.service.schema import CalibrationRow, Job, SessionRow
from estimator.service.tokens import Caller, Scope

LOOK_EVERY_S = 3600.0
MOST_LISTED = 3  # jobs, and users, that a refusal names
BATCH = "batch"
log = logging.getLogger("coilcal.service")


def remove_job(db: Session, job: Job) -> None:
    """Delete the rows of a job and of its calibration.

    Raises:
        Problem: It has not ended, or is the judgement of a session.
    """
    if job.state not in ENDED:
        raise Problem(409, "job", "must have ended; cancel it first", job.state, job.id)
    if job.kind == RECALIBRATE:
        rule = "must be of another kind; the judgement of a session goes with the session"
        raise Problem(409, "job", rule, job.kind, job.id)
    _remove_rows(db, [job])


def remove_session(db: Session, session: SessionRow, caller: Caller) -> list[str]:
    """Delete the row of a session with its judgements.

    Args:
        db: The database, for writing.
        session: Its row.
        caller: The caller, who may cancel and delete jobs of their own.
    Returns: Ids of the jobs that are gone with it.
    Raises:
        Problem: A job has worked with it, or works; it says whose, and what to do first.
    """
    jobs = list(db.scalars(select(Job).where(Job.session_id == session.id)))
    others = [job for job in jobs if job.kind != RECALIBRATE or job.state not in ENDED]
    batches = db.scalars(select(Job).where(Job.kind == BATCH))
    others += [
        job for job in batches if job not in others and session.id in job.options.get("session_ids", ())
    ]
    if others:
        rule = f"must have no jobs; {_first_steps(others, caller)}"
        first = (f"{job.kind} {job.id} of {job.user} ({job.state})" for job in others[:MOST_LISTED])
        raise Problem(409, "session", rule, listed(first, len(others)), session.id)
    _remove_rows(db, jobs)
    db.delete(session)
    return [job.id for job in jobs]


def _first_steps(jobs: Sequence[Job], caller: Caller) -> str:
    """What has to be done with jobs of a session before it can be deleted, and by whom."""
    own = [job for job in jobs if caller.scope.includes(Scope.ADMIN) or job.user == caller.user]
    others = sorted({job.user for job in jobs if job not in own})
    whose, steps = "yours" if others else "them", []
    if any(job.state not in ENDED for job in own):
        steps.append(f"cancel {whose} unless ended (POST /v1/jobs/ID/cancel)")
    if own:
        steps.append(f"delete {whose} (DELETE /v1/jobs/ID)")
    if others:
        steps.append(f"ask {', '.join(others[:MOST_LISTED])} or an admin to delete the others")
    return ", then ".join(steps)


def _remove_rows(db: Session, jobs: Iterable[Job]) -> None:
    for job in jobs:
        db.execute(delete(CalibrationRow).where(CalibrationRow.job_id == job.id))
        db.delete(job)
    db.flush()


def remove_old_jobs(database: Database, keep_days: float, remove_folder: Callable[[str], None]) -> int:
    """Remove jobs that ended long ago, judgements of sessions excepted.

    Args:
        database: Rows of jobs.
        keep_days: For how long jobs are kept; 0 keeps them for ever.
        remove_folder: Removes that of a job, by its id.
    Returns: The number of jobs.
    """
    if not keep_days:
        return 0
    before = (datetime.now(UTC) - timedelta(days=keep_days)).isoformat(timespec="milliseconds")
    with database.writing() as db:
        old = select(Job).where(Job.state.in_(ENDED), Job.kind != RECALIBRATE, Job.ended < before)
        jobs = list(db.scalars(old))
        ids = [job.id for job in jobs]
        _remove_rows(db, jobs)
    for job_id in ids:
        remove_folder(job_id)
    if ids:
        log.info("old jobs were removed", extra={"jobs": len(ids), "days": keep_days})
    return len(ids)


def remove_folders_without_row(database: Database, jobs: Path) -> None:
    """Remove folders of jobs that are gone, as a kill between row and folder leaves them."""
    with database.reading() as db:
        known = set(db.scalars(select(Job.id)))
    for folder in jobs.iterdir() if jobs.is_dir() else ():
        if folder.name not in known:
            shutil.rmtree(folder, ignore_errors=True)
