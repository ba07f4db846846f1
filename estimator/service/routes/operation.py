"""State of the service: whether it answers and can work, its metrics and its audit log."""

from __future__ import annotations

from importlib.metadata import version
from typing import Annotated, Literal

from fastapi import APIRouter, Query, Response
from prometheus_client import CONTENT_TYPE_PLAIN_0_0_4
from pydantic import BaseModel
from sqlalchemy import func, select

from estimator.service.answers import Limit, shown_as
from estimator.service.job_queue import QUEUED, RUNNING
from estimator.service.problems import Problem
from estimator.service.requests import Admin, CoreOf, JsonRoute, Reader
from estimator.service.schema import Audit, Job
from estimator.service.tokens import Scope

router = APIRouter(route_class=JsonRoute)
Before = Annotated[
    int | None, Query(ge=1, le=2**53, description="`number` of the last entry of the page before.")
]


class Health(BaseModel):
    """The process answers."""

    status: Literal["ok"] = "ok"


class State(BaseModel):
    """The service, its caller, and how much there is to do."""

    version: str
    user: str
    scope: Scope
    n_queued: int
    n_running: int
    n_workers: int


class AuditEntry(BaseModel):
    """One change."""

    number: int
    time: str
    user: str
    token_id: str | None
    request_id: str
    action: str
    target: str


@router.get("/healthz", tags=["operation"])
def healthz() -> Health:
    """The process answers."""
    return Health()


@router.get("/readyz", tags=["operation"])
def readyz(core: CoreOf, response: Response) -> Health:
    """Requests are served, the data folder can be written, and jobs can run."""
    if not core.jobs.is_ready:
        why = "it is starting" if core.jobs.fault is None else "its workers cannot be had"
        raise Problem(503, "service", f"must be ready; {why}", headers={"Retry-After": "2"})
    if (fault := core.storage.fault) is not None:
        raise fault
    with core.database.reading() as db:
        db.scalar(select(func.count()).select_from(Job))
    response.headers["Cache-Control"] = "no-store"
    return Health()


@router.get(
    "/metrics",
    tags=["operation"],
    response_class=Response,
    responses={200: {"content": {"text/plain": {"schema": {"type": "string"}}}}},
)
def metrics(core: CoreOf, caller: Reader) -> Response:  # noqa: ARG001
    """Counts of requests, readings, jobs and sessions, as Prometheus reads them."""
    return Response(core.metrics.text(), media_type=CONTENT_TYPE_PLAIN_0_0_4)


@router.get("/v1/state", tags=["operation"])
def state(core: CoreOf, caller: Reader) -> State:
    """Version, caller and queue."""
    with core.database.reading() as db:
        n = {
            name: db.scalar(select(func.count()).where(Job.state == name)) or 0 for name in (QUEUED, RUNNING)
        }
    return State(
        version=version("coilcal"),
        user=caller.user,
        scope=caller.scope,
        n_queued=n[QUEUED],
        n_running=n[RUNNING],
        n_workers=core.settings.n_workers,
    )


@router.get("/v1/audit", tags=["operation"])
def audit(core: CoreOf, caller: Admin, limit: Limit = 50, before: Before = None) -> list[AuditEntry]:  # noqa: ARG001
    """Who changed what, newest first; those before a number, if one is given."""
    rows = select(Audit).order_by(Audit.number.desc()).limit(limit)
    if before is not None:
        rows = rows.where(Audit.number < before)
    with core.database.reading() as db:
        return [shown_as(AuditEntry, row) for row in db.scalars(rows)]
