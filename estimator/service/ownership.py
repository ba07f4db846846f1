"""Ownership: a thing is changed by the user who made it, and by callers with the scope admin. Every token reads everything.

What belongs to a user belongs to every token of that user, so that an instrument keeps its sessions when its token is renewed, and
those who share an instrument share its user. A rig belongs to the user of its first version, and with it the registry that all
versions share: it says which calibration is in use.

A route that changes something named in its path depends on one of these (`dependencies=[OWN_SESSION]`); `create_app` refuses any other.
"""

from __future__ import annotations

from typing import Any

from fastapi import Depends
from sqlalchemy import ColumnElement, Select, select

from estimator.service.core import Core
from estimator.service.problems import Problem, not_found
from estimator.service.requests import CoreOf, Id, Writer
from estimator.service.schema import Job, RigVersion, Schedule, SessionRow
from estimator.service.tokens import Caller, Scope


def check_registry(core: Core, caller: Caller, rig_name: str) -> None:
    """Refuse to change the registry of another user's rig.

    Args:
        core: Of the service.
        caller: The caller.
        rig_name: Name of the rig, of which there is a version.
    Raises:
        Problem: The rig belongs to another user, and the caller is no admin.
    """
    _check(core, caller, _first_user(RigVersion.name == rig_name), "rig", rig_name)


def _own_session(core: CoreOf, caller: Writer, session_id: Id) -> None:
    _check(core, caller, select(SessionRow.user).where(SessionRow.id == session_id), "session", session_id)


def _own_job(core: CoreOf, caller: Writer, job_id: Id) -> None:
    _check(core, caller, select(Job.user).where(Job.id == job_id), "job", job_id)


def _own_schedule(core: CoreOf, caller: Writer, schedule_id: Id) -> None:
    _check(core, caller, select(Schedule.user).where(Schedule.id == schedule_id), "schedule", schedule_id)


def _own_registry(core: CoreOf, caller: Writer, rig_id: Id) -> None:
    name = select(RigVersion.name).where(RigVersion.id == rig_id).scalar_subquery()
    _check(core, caller, _first_user(RigVersion.name == name), "rig", rig_id)


def _first_user(is_of_rig: ColumnElement[bool]) -> Select[Any]:
    return select(RigVersion.user).where(is_of_rig).order_by(RigVersion.created, RigVersion.id).limit(1)


def _check(core: Core, caller: Caller, owner: Select[Any], thing: str, row_id: str) -> None:
    if caller.scope.includes(Scope.ADMIN):  # whether it is there the route says
        return
    with core.database.reading() as db:
        user = db.scalar(owner)
    if user is None:
        raise not_found(thing, row_id)
    if user != caller.user:
        rule = f"must be one's own, unless the token has the scope admin; it belongs to {user}"
        raise Problem(403, thing, rule, row_id)


OWN_SESSION, OWN_JOB = Depends(_own_session), Depends(_own_job)
OWN_SCHEDULE, OWN_REGISTRY = Depends(_own_schedule), Depends(_own_registry)
OWNED = frozenset({_own_session, _own_job, _own_schedule, _own_registry})
