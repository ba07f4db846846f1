"""Schedules: when the new sessions of a rig are judged."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated

from pydantic import BaseModel, Field
from sqlalchemy import func, select

from estimator.service.answers import ListingOf, Page, row_of, shown_as
from estimator.service.database import new_id, now
from estimator.service.ownership import OWN_SCHEDULE, check_registry
from estimator.service.problems import Problem, check_limits
from estimator.service.requests import ID, ChangeOf, CoreOf, Id, Seed, router_of
from estimator.service.routes.rigs import rig_row_of
from estimator.service.schedules import next_run, trigger_of
from estimator.service.schema import RigVersion, Schedule

router = router_of("/v1/schedules", "schedules")
MOST_SCHEDULES, MOST_OF_USER = 100, 50


class NewSchedule(BaseModel, extra="forbid", strict=True):
    """A schedule to make: either a cron expression or a number of seconds."""

    rig_id: Annotated[
        str, Field(pattern=ID, description="Any version of the rig; sessions of all are judged.")
    ]
    cron: Annotated[
        str | None,
        Field(min_length=9, max_length=100, description="Minute, hour, day, month, day of the week."),
    ] = None
    every_s: Annotated[int | None, Field(ge=60, le=32_000_000, description="Seconds between two runs.")] = (
        None
    )
    timezone: Annotated[str, Field(min_length=1, max_length=64, description="Of the cron expression.")] = (
        "UTC"
    )
    seed: Seed = 0


class ScheduleInfo(BaseModel):
    """A schedule; `is_at_work` while sessions of its last run are being judged."""

    id: str
    rig_name: str
    cron: str | None
    every_s: int | None
    timezone: str
    seed: int
    created: str
    user: str
    next_run: str
    last_run: str | None
    is_at_work: bool


@router.post("", status_code=201)
def create_schedule(change: ChangeOf, body: NewSchedule) -> ScheduleInfo:
    """Judge, from now on, the sessions of a rig of one's own that are closed and were not judged yet, of all users, one after the other."""
    if (body.cron is None) == (body.every_s is None):
        raise Problem(422, "schedule", "must have either cron or every_s", place="body")
    if body.cron is not None:
        trigger_of(body.cron, body.timezone)
    core, user = change.core, change.caller.user
    check_registry(core, change.caller, rig_row_of(core, body.rig_id).name)
    with core.database.writing() as db:
        rig = row_of(db, RigVersion, body.rig_id, "rig")
        n = select(func.count()).select_from(Schedule)
        own = n.where(Schedule.user == user)
        limits = {
            "schedules": (db.scalar(n), MOST_SCHEDULES),
            f"schedules of {user}": (db.scalar(own), MOST_OF_USER),
        }
        check_limits(limits, 409, "must be at most {}; delete one first")
        told = body.model_dump(exclude={"rig_id"})
        row = Schedule(id=new_id(), rig_name=rig.name, created=now(), user=user, is_at_work=False, **told)
        row.next_run = next_run(row, datetime.now(UTC))
        db.add(row)
        change.note(db, "schedule.create", row.id)
        return shown_as(ScheduleInfo, row)


@router.get("")
def list_schedules(listing: ListingOf) -> Page[ScheduleInfo]:
    """Schedules, newest first."""
    return listing.page(Schedule, ScheduleInfo)


@router.get("/{schedule_id}")
def get_schedule(core: CoreOf, schedule_id: Id) -> ScheduleInfo:
    """One schedule."""
    with core.database.reading() as db:
        return shown_as(ScheduleInfo, row_of(db, Schedule, schedule_id, "schedule"))


@router.post("/{schedule_id}/run", status_code=202, dependencies=[OWN_SCHEDULE])
def run_schedule(change: ChangeOf, schedule_id: Id) -> ScheduleInfo:
    """Make a schedule of one's own due now."""
    with change.core.database.writing() as db:
        row = row_of(db, Schedule, schedule_id, "schedule")
        row.next_run = now()
        change.note(db, "schedule.run", schedule_id)
        return shown_as(ScheduleInfo, row)


@router.delete("/{schedule_id}", status_code=204, dependencies=[OWN_SCHEDULE])
def delete_schedule(change: ChangeOf, schedule_id: Id) -> None:
    """End a schedule of one's own; jobs that it has queued go on."""
    with change.core.database.writing() as db:
        db.delete(row_of(db, Schedule, schedule_id, "schedule"))
        change.note(db, "schedule.delete", schedule_id)
