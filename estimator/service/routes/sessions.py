"""Sessions: begun for a rig, appended to and closed, then downloaded and calibrated."""

from __future__ import annotations

import tempfile
from collections.abc import AsyncIterator, Iterator
from contextlib import aclosing
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Literal

from fastapi import Depends, Query, Request
from fastapi.sse import EventSourceResponse, ServerSentEvent
from pydantic import BaseModel, Field
from sqlalchemy import func, select
from sqlalchemy.orm import Session as DatabaseSession
from starlette.responses import Response

from estimator.rig_files.read import rig_from_text
from estimator.service.answers import ListingOf, Page, Search, file_of, file_with_etag, row_of, shown_as
from estimator.service.core import Core
from estimator.service.database import new_id, now
from estimator.service.labels import Labelled, SessionLabels, containing, relabelled
from estimator.service.ownership import OWN_SESSION
from estimator.service.problems import Problem, check_limits, not_found
from estimator.service.readings import readings_of
from estimator.service.requests import (
    ID,
    STREAM,
    ChangeOf,
    CoreOf,
    Id,
    Key,
    documented_body,
    raw_body,
    router_of,
)
from estimator.service.schema import RigVersion, SessionRow
from estimator.service.tokens import Caller
from estimator.service.watched import Watched
from estimator.store.importers.readings_csv import write_readings_csv
from estimator.store.session import load_session
from estimator.store.zipped import zipped

OPEN, CLOSED = "open", "closed"
router = router_of("/v1/sessions", "sessions")
Ndjson = Annotated[bytes, Depends(raw_body("application/x-ndjson", "application/jsonl"))]


class NewSession(BaseModel, extra="forbid"):
    """A session to begin."""

    rig_id: Annotated[str, Field(pattern=ID)]
    source: Annotated[
        str, Field(min_length=1, max_length=500, description="Origin of the readings, in words.")
    ]


class SessionInfo(Labelled):
    """A session; a closed one has the SHA-256 of its readings and rig as `hash`."""

    id: str
    rig_id: str
    source: str
    state: Literal["open", "closed"]
    created: str
    user: str
    n_readings: int | None
    hash: str | None
    measured: str | None


class Appended(BaseModel):
    """Readings that are on disk: all of the session, and how many of them this request has added."""

    n_readings: int
    n_new: int


def _row_of(core: Core, session_id: str) -> SessionRow:
    with core.database.reading() as db:
        return row_of(db, SessionRow, session_id, "session")


def closed_row_of(core: Core, session_id: str) -> SessionRow:
    """The row of a session that must be closed."""
    row = _row_of(core, session_id)
    if row.state != CLOSED:
        raise Problem(409, "session", "must be closed first; it is open", place=session_id)
    return row


def open_row_of(core: Core, session_id: str) -> SessionRow:
    """The row of a session that must be open."""
    row = _row_of(core, session_id)
    if row.state != OPEN:
        raise Problem(409, "session", "must be open; it is closed", place=session_id)
    return row


@router.post(
    "", status_code=201, responses={200: {"model": SessionInfo, "description": "The key was used before."}}
)
def create_session(response: Response, change: ChangeOf, body: NewSession, key: Key = None) -> SessionInfo:
    """Begin a session that takes readings."""
    core, caller, session_id = change.core, change.caller, new_id()
    try:
        with core.database.writing() as db:
            if key is not None and (known := _begun_before(db, caller, body, key)) is not None:
                response.status_code = 200
                return known
            version = row_of(db, RigVersion, body.rig_id, "rig")
            _check_open_sessions(core, db, caller)
            core.sessions.create(session_id, rig_from_text(version.text, "rig"), body.source)
            row = SessionRow(id=session_id, rig_id=version.id, source=body.source, state=OPEN, created=now())
            row.user, row.idempotency_key, row.measured = caller.user, key, row.created
            db.add(row)
            change.note(db, "session.create", session_id)
            return shown_as(SessionInfo, row)
    except BaseException:
        core.sessions.remove(session_id)
        raise


def _check_open_sessions(core: Core, db: DatabaseSession, caller: Caller) -> None:
    """Refuse one more open session where there are too many, of all users or of this one."""
    n_open = select(func.count()).where(SessionRow.state == OPEN)
    own, settings = n_open.where(SessionRow.user == caller.user), core.settings
    limits = {
        "open sessions": (db.scalar(n_open), settings.most_open_sessions),
        f"open sessions of {caller.user}": (db.scalar(own), settings.most_open_sessions_per_user),
    }
    check_limits(limits, 429, "must be at most {}; close one first", retry_after_s=60)


def _begun_before(db: DatabaseSession, caller: Caller, body: NewSession, key: str) -> SessionInfo | None:
    """The session that this key has begun."""
    row = db.scalar(
        select(SessionRow).where(SessionRow.user == caller.user, SessionRow.idempotency_key == key)
    )
    if row is not None and (row.rig_id, row.source) != (body.rig_id, body.source):
        rule = "must be used for one session; another has it"
        raise Problem(409, "idempotency key", rule, key, "header Idempotency-Key")
    return None if row is None else shown_as(SessionInfo, row)


@router.get("")
def list_sessions(
    listing: ListingOf,
    rig_id: Annotated[str | None, Query(pattern=ID)] = None,
    hash: Annotated[str | None, Query(pattern=r"^[0-9a-f]{64}$")] = None,
    search: Search = None,
) -> Page[SessionInfo]:
    """Sessions, newest first."""
    return listing.page(SessionRow, SessionInfo, *containing(SessionRow, search), rig_id=rig_id, hash=hash)


@router.patch("/{session_id}", dependencies=[OWN_SESSION])
def label_session(change: ChangeOf, session_id: Id, body: SessionLabels) -> SessionInfo:
    """Give a session of one's own a name, a note, tags, or the time when it was measured."""
    return shown_as(SessionInfo, relabelled(change, SessionRow, session_id, "session", body))


@router.get("/{session_id}")
def get_session(core: CoreOf, session_id: Id) -> SessionInfo:
    """One session; of an open one, the readings that are on disk are counted."""
    info = shown_as(SessionInfo, _row_of(core, session_id))
    if info.state == OPEN:
        info.n_readings = core.sessions.n_readings(session_id)
    return info


@router.post(
    "/{session_id}/readings",
    openapi_extra=documented_body("application/x-ndjson", "A reading in each line, numbered by `sequence`."),
    dependencies=[OWN_SESSION],
)
def append_readings(change: ChangeOf, session_id: Id, body: Ndjson) -> Appended:
    """Append readings to a session of one's own. The answer comes when they are on disk; to send some again does no harm."""
    core = change.core
    if not core.sessions.path(session_id).is_dir():
        raise not_found("session", session_id)
    readings = readings_of(body, core.sessions.rig(session_id))
    n_readings, n_new = core.sessions.append(session_id, readings)
    core.metrics.readings.inc(n_new)
    appender = session_id, change.caller.token_id
    if appender not in core.appenders:  # one entry is enough
        with core.database.writing() as db:
            change.note(db, "session.append", session_id)
        core.appenders.add(appender)
    core.watching.wake(session_id)
    return Appended(n_readings=n_readings, n_new=n_new)


def _watched(core: CoreOf, session_id: Id) -> Iterator[Watched]:
    open_row_of(core, session_id)
    with core.watching.watched(session_id) as watched:
        yield watched


@router.get("/{session_id}/live", response_class=EventSourceResponse, dependencies=[STREAM])
async def watch_session(
    core: CoreOf, watched: Annotated[Watched, Depends(_watched)]
) -> AsyncIterator[ServerSentEvent]:
    """The estimate of an open session as server-sent events: `estimate` after readings were appended, and `end` when it is closed."""
    async with aclosing(watched.states(lambda: core.is_ending)) as states:
        async for state in states:
            yield ServerSentEvent(data=asdict(state), event="end" if state.has_ended else "estimate")


@router.post("/{session_id}/close", dependencies=[OWN_SESSION])
def close_session(change: ChangeOf, session_id: Id) -> SessionInfo:
    """End a session of one's own, so that it can be calibrated; to close it again does no harm."""
    core = change.core
    row = _row_of(core, session_id)
    if row.state == CLOSED:
        return shown_as(SessionInfo, row)
    session = core.sessions.seal(session_id)
    core.appenders = {appender for appender in core.appenders if appender[0] != session_id}
    core.watching.wake(session_id)
    with core.database.writing() as db:
        row = db.get_one(SessionRow, session_id)
        if row.state == OPEN:
            row.state, row.n_readings, row.hash = CLOSED, len(session.observations), session.hash
            change.note(db, "session.close", session_id)
        return shown_as(SessionInfo, row)


@router.get("/{session_id}/session.zip", **file_of("application/zip"))
def download_zip(request: Request, core: CoreOf, session_id: Id) -> Response:
    """A closed session as a zipped session.zarr."""
    row = closed_row_of(core, session_id)
    path = core.sessions.path(session_id)
    return file_with_etag(request, str(row.hash), lambda: zipped(path), "session.zarr.zip", "application/zip")


@router.get("/{session_id}/readings.csv", **file_of("text/csv"))
def download_csv(request: Request, core: CoreOf, session_id: Id) -> Response:
    """The readings of a closed session as CSV, in SI, with every digit."""
    row = closed_row_of(core, session_id)

    def csv() -> bytes:
        with tempfile.TemporaryDirectory(dir=core.scratch()) as folder:
            path = Path(folder) / "readings.csv"
            write_readings_csv(load_session(core.sessions.path(session_id)), path)
            return path.read_bytes()

    return file_with_etag(request, f"{row.hash}-csv", csv, "readings.csv", "text/csv")
