"""The queue of jobs in the database: bounded, first in first out for each user, and turn by turn between users."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from estimator.service.database import Database, new_id, now
from estimator.service.problems import Problem, check_limits
from estimator.service.schema import CalibrationRow, Job
from estimator.service.settings import Settings
from estimator.service.webhooks import announce_end

QUEUED, RUNNING, DONE, FAILED, CANCELLED = "queued", "running", "done", "failed", "cancelled"
STATES = (QUEUED, RUNNING, DONE, FAILED, CANCELLED)
ENDED = (DONE, FAILED, CANCELLED)
RETRY_AFTER_S = 30


class JobQueue:
    """Jobs that wait, run and have ended.

    Args:
        database: Where they are kept.
        settings: Limits of their number.
    """

    def __init__(self, database: Database, settings: Settings) -> None:
        self._database, self._settings = database, settings

    def add(self, db: Session, job: Mapping[str, Any]) -> tuple[Job, bool]:
        """Queue a job in a transaction.

        Returns: The job, and whether it is new. The same user's job with the same idempotency key is not made again.
        Raises:
            Problem: The queue is full, or the key was used for something else.
        """
        key, user = job["idempotency_key"], job["user"]
        if key is not None:
            known = db.scalar(select(Job).where(Job.user == user, Job.idempotency_key == key))
            if known is not None:
                same = ("kind", "session_id", "rig_id", "options")
                if any(getattr(known, name) != job[name] for name in same):
                    rule = "must be used for one job; another has it"
                    raise Problem(409, "idempotency key", rule, key, "header Idempotency-Key")
                return known, False
        waiting = db.scalars(select(Job.user).where(Job.state == QUEUED)).all()
        limits = {
            "queue": (len(waiting), self._settings.most_queued),
            f"queue of {user}": (waiting.count(user), self._settings.most_queued_per_user),
        }
        check_limits(limits, 429, "must hold at most {} jobs that wait; it is full", RETRY_AFTER_S)
        row = Job(id=new_id(), state=QUEUED, created=now(), starts=0, **job)
        db.add(row)
        db.flush()
        return row, True

    def take_back(self) -> None:
        """Queue again what ran when the service ended; it goes on from its folder."""
        with self._database.writing() as db:
            for job in db.scalars(select(Job).where(Job.state == RUNNING)):
                job.state = QUEUED

    def next(self) -> Job | None:
        """Mark the next job as running and return it; None if none may run.

        The user with the fewest running jobs is next; among those, the one whose last start is longest ago.
        """
        with self._database.writing() as db:
            running = Counter(db.scalars(select(Job.user).where(Job.state == RUNNING)))
            first: dict[str, Job] = {}
            for job in db.scalars(select(Job).where(Job.state == QUEUED).order_by(Job.number)):
                first.setdefault(job.user, job)
            may = [user for user in first if running[user] < self._settings.most_running_per_user]
            if not may:
                return None
            starts = select(Job.user, func.max(Job.started)).where(Job.user.in_(may)).group_by(Job.user)
            last_start = {user: started or "" for user, started in db.execute(starts)}
            # A job that a restart has interrupted goes on before others begin.
            user = min(may, key=lambda u: (first[u].starts == 0, running[u], last_start[u], first[u].number))
            job = first[user]
            job.state, job.started, job.starts = RUNNING, now(), job.starts + 1
            return job

    def give_back(self, job_id: str) -> None:
        """Queue a job again whose scheduler was lost."""
        with self._database.writing() as db:
            job = db.scalar(select(Job).where(Job.id == job_id))
            if job is not None and job.state == RUNNING:
                job.state = QUEUED

    def end(self, job_id: str, result: Mapping[str, Any]) -> None:
        """Record how a job has ended, with the calibration that it made; one that was cancelled stays so."""
        with self._database.writing() as db:
            job = db.scalar(select(Job).where(Job.id == job_id))
            if job is None or job.state != RUNNING:
                return
            job.state, job.fault, job.ended = result["state"], result["fault"], now()
            announce_end(db, job, result)
            if result.get("has_calibration"):
                db.add(
                    CalibrationRow(
                        id=new_id(),
                        job_id=job.id,
                        session_id=job.session_id,
                        rig_name=result["rig_name"],
                        created=now(),
                        user=job.user,
                    )
                )

    def states(self, job_ids: list[str]) -> dict[str, str]:
        """State of each of some jobs."""
        with self._database.reading() as db:
            rows = db.execute(select(Job.id, Job.state).where(Job.id.in_(job_ids)))
            return {job_id: state for job_id, state in rows}  # noqa: C416  rows are not pairs to a type checker
