"""Periodic recalibration: when it is due, the closed sessions of a rig that were not judged yet are, one after the other.

The row of a schedule is its state. What fell into a time without a service is made up for once, when there is one again.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import asdict
from datetime import UTC, datetime, timedelta
from zoneinfo import ZoneInfo

from apscheduler.triggers.cron import CronTrigger
from sqlalchemy import ColumnElement, and_, select
from sqlalchemy.orm import Session

from estimator.inference.ensemble import SamplerSettings
from estimator.service.database import Database
from estimator.service.job_queue import ENDED, JobQueue
from estimator.service.problems import Problem
from estimator.service.schema import Job, RigVersion, Schedule, SessionRow

RECALIBRATE = "recalibrate"
LOOK_EVERY_S = 1.0
log = logging.getLogger("coilcal.service")


def trigger_of(cron: str, timezone: str) -> CronTrigger:
    """When a cron expression is due.

    Raises:
        Problem: It is none, the time zone is not known, or no day ever fits.
    """
    try:
        zone = ZoneInfo(timezone)
    except (ValueError, KeyError, OSError) as error:
        raise Problem(422, "timezone", "must be a name such as Europe/Zurich", timezone, "body") from error
    try:
        trigger = CronTrigger.from_crontab(cron, timezone=zone)
    except (ValueError, KeyError) as error:
        rule = "must have five fields: minute, hour, day, month and day of the week"
        raise Problem(422, "cron", rule, cron, "body") from error
    if trigger.get_next_fire_time(None, datetime.now(UTC)) is None:
        raise Problem(422, "cron", "must be due on some day; no day fits", cron, "body")
    return trigger


def next_run(schedule: Schedule, now: datetime) -> str:
    """When a schedule is due after an instant, as the database holds times."""
    if schedule.cron is not None:
        due: datetime = trigger_of(schedule.cron, schedule.timezone).get_next_fire_time(
            None, now + timedelta(microseconds=1)
        )
    else:
        due = now + timedelta(seconds=schedule.every_s or 0)
    return due.astimezone(UTC).isoformat(timespec="milliseconds")


class Schedules:
    """Queues the jobs of schedules that are due.

    Args:
        database: Where schedules and sessions are kept.
        queue: Where jobs go.
        wake: Called when there is a new job.
    """

    def __init__(self, database: Database, queue: JobQueue, wake: Callable[[], None]) -> None:
        self._database, self._queue, self._wake = database, queue, wake

    def tick(self) -> int:
        """Begin the schedules that are due and go on with those that have begun; the number of jobs that were queued."""
        now, n_queued = datetime.now(UTC), 0
        with self._database.reading() as db:
            due = Schedule.next_run <= now.isoformat(timespec="milliseconds")
            schedule_ids = list(db.scalars(select(Schedule.id).where(due | Schedule.is_at_work)))
        for schedule_id in schedule_ids:
            n_queued += self._go_on(schedule_id, now)
        if n_queued:
            self._wake()
        return n_queued

    def _go_on(self, schedule_id: str, now: datetime) -> int:
        """Queue the next session of a schedule, in one transaction with its new state; 1 if there was one."""
        try:
            with self._database.writing() as db:
                schedule = db.get(Schedule, schedule_id)
                if schedule is None:
                    return 0
                if schedule.next_run <= now.isoformat(timespec="milliseconds"):
                    schedule.is_at_work = True
                    schedule.last_run = now.isoformat(timespec="milliseconds")
                    schedule.next_run = next_run(schedule, now)
                if not schedule.is_at_work or _is_judging(db, schedule.rig_name):
                    return 0  # the order of sessions matters
                session = _oldest_unjudged(db, schedule.rig_name)
                if session is None:
                    schedule.is_at_work = False
                    return 0
                job, is_new = self._queue.add(db, _asked(schedule, session))
        except Problem as refusal:  # the queue is full, and is asked again
            log.warning("a schedule waits", extra={"schedule": schedule_id, "fault": str(refusal)})
            return 0
        log.info("a schedule queues a job", extra={"schedule": schedule_id, "job": job.id})
        return int(is_new)


def _asked(schedule: Schedule, session: SessionRow) -> dict[str, object]:
    settings = asdict(SamplerSettings())
    settings.pop("seed")
    return {
        "kind": RECALIBRATE,
        "user": schedule.user,
        "session_id": session.id,
        "rig_id": None,
        "options": {"registry": schedule.rig_name, "seed": schedule.seed, "settings": settings},
        "idempotency_key": f"schedule:{schedule.id}:{session.id}",
    }


def _is_judging(db: Session, rig_name: str) -> bool:
    """Whether a session of a rig is being judged, or waits for it."""
    return (
        db.scalar(select(Job.id).where(is_judgement_of(rig_name), Job.state.not_in(ENDED)).limit(1))
        is not None
    )


def is_judgement_of(rig_name: str) -> ColumnElement[bool]:
    """Condition of jobs that judge a session in the registry of a rig."""
    return and_(Job.kind == RECALIBRATE, Job.options["registry"].as_string() == rig_name)


def _oldest_unjudged(db: Session, rig_name: str) -> SessionRow | None:
    """The first closed session of a rig, in any version of its file, for which no judgement in the rig's own registry was asked."""
    judged = select(Job.session_id).where(is_judgement_of(rig_name))
    rows = (
        select(SessionRow)
        .join(RigVersion, RigVersion.id == SessionRow.rig_id)
        .where(RigVersion.name == rig_name, SessionRow.state == "closed")
        .where(SessionRow.id.not_in(judged))
    )
    return db.scalar(rows.order_by(SessionRow.created, SessionRow.id).limit(1))
