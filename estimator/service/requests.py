"""What routes have in common: who asks, bodies that are not JSON, pages of lists, ETags, and the audit log."""

from __future__ import annotations

import base64
import binascii
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Generic, TypeVar

from fastapi import Depends, Header, Path, Query, Request
from fastapi.routing import APIRoute
from pydantic import BaseModel, Field
from sqlalchemy import select, tuple_
from sqlalchemy.orm import Session
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from estimator.json_files import json_of
from estimator.service.core import Core
from estimator.service.database import now
from estimator.service.problems import Problem, not_found
from estimator.service.schema import Audit, Base
from estimator.service.tokens import Caller, Scope

ID = r"^[0-9a-f]{32}$"
MOST_ITEMS, ITEMS = 500, 50
LARGEST_SEED = 2**32 - 1
Item = TypeVar("Item")
Shape = TypeVar("Shape", bound=BaseModel)
Row = TypeVar("Row", bound=Base)
BINARY: Mapping[str, Any] = {"type": "string", "format": "binary"}
Seed = Annotated[int, Field(ge=0, le=LARGEST_SEED, description="Of everything random.")]


def core_of(request: Request) -> Core:
    """The core of the application."""
    core: Core = request.app.state.core
    return core


CoreOf = Annotated[Core, Depends(core_of)]
Key = Annotated[
    str | None,
    Header(
        alias="Idempotency-Key",
        min_length=1,
        max_length=200,
        pattern=r"^[\x21-\x7e]+$",
        description="The same key again makes nothing new, and gives what it has made.",
    ),
]
Id = Annotated[str, Path(pattern=ID, description="Id that the service has given.")]


class Needs:
    """Admits callers whose token has a scope; every route of the API has one."""

    def __init__(self, scope: Scope) -> None:
        self.scope = scope

    def __call__(self, request: Request) -> Caller:
        """The caller, if the scope suffices."""
        caller: Caller | None = request.scope.get("caller")
        if caller is None:
            raise Problem(401, "token", "must be given")
        if not caller.scope.includes(self.scope):
            raise Problem(403, "token", f"must have the scope {self.scope}", caller.scope)
        return caller


Reader = Annotated[Caller, Depends(Needs(Scope.READ))]
Writer = Annotated[Caller, Depends(Needs(Scope.WRITE))]
Admin = Annotated[Caller, Depends(Needs(Scope.ADMIN))]


def _room(core: CoreOf, caller: Reader) -> Iterator[None]:
    with core.streams.taken(caller.user):
        yield


StreamRoom = Annotated[None, Depends(_room)]
"""Dependency of routes with event streams, each of which takes one of the places for streams. What such a route refuses has to be refused
by what it depends on: once it runs, the answer has begun."""


async def _import_room(core: CoreOf) -> AsyncIterator[None]:
    async with core.importing.taken():
        yield


ImportRoom = Annotated[None, Depends(_import_room)]
"""Dependency of routes that read a whole session, of which few run at once; stands after the body, so that who sends slowly takes no
place."""


def raw_body(*media_types: str) -> Callable[[Request], Coroutine[Any, Any, bytes]]:
    """A dependency that gives the bytes of a body of one of some media types; the first is the one that is documented."""

    async def body(request: Request) -> bytes:
        received = request.headers.get("content-type", "").partition(";")[0].strip().lower()
        if received not in media_types:
            raise Problem(
                415, "body", f"must be {' or '.join(media_types)}", received or "none", "header Content-Type"
            )
        return await request.body()

    return body


def documented_body(media_type: str, description: str) -> dict[str, Any]:
    """OpenAPI description of a required body of this media type."""
    schema = BINARY if media_type == "application/zip" else {"type": "string", "minLength": 1}
    content = {media_type: {"schema": schema}}
    return {"requestBody": {"required": True, "description": description, "content": content}}


class _JsonRequest(Request):
    """A request whose JSON is read by the loader of all JSON."""

    async def json(self) -> Any:
        """The value of the body, read in a thread, since a long one takes seconds.

        Raises:
            InvalidInput: It is no JSON, or has a key twice, a number that is none, half a character or too many levels.
        """
        return await run_in_threadpool(json_of, await self.body(), "body")


class JsonRoute(APIRoute):
    """A route of the service; FastAPI's own takes JSON with a key twice, of which one value is lost."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """See `APIRoute`."""
        handler = super().get_route_handler()

        async def handled(request: Request) -> Response:
            return await handler(_JsonRequest(request.scope, request.receive))

        return handled


class Page(BaseModel, Generic[Item]):
    """A part of a list, newest first; `next` is the cursor of the part that follows, null after the last one."""

    items: list[Item]
    next: str | None


Limit = Annotated[int, Query(ge=1, le=MOST_ITEMS, description="Items of a page.")]
Cursor = Annotated[str | None, Query(max_length=200, description="`next` of the page before.")]


@dataclass(frozen=True)
class Listing:
    """Which part of a list is asked for."""

    core: CoreOf
    limit: Limit = ITEMS
    cursor: Cursor = None

    def page(self, table: Any, shape: type[Shape], **equal: str | None) -> Page[Shape]:
        """A page of the rows of a table, which has `created` and `id`.

        Args:
            table: Its class.
            shape: Rows as the API shows them.
            equal: Values of columns that rows must have; None admits all.
        """
        key = tuple_(table.created, table.id)
        asked = {name: value for name, value in equal.items() if value is not None}
        rows = select(table).filter_by(**asked)
        if self.cursor is not None:
            rows = rows.where(key < _key(self.cursor))
        rows = rows.order_by(table.created.desc(), table.id.desc()).limit(self.limit + 1)
        with self.core.database.reading() as db:
            records = list(db.scalars(rows))
        last = records[self.limit - 1] if len(records) > self.limit else None
        following = None
        if last is not None:
            following = base64.urlsafe_b64encode(f"{last.created} {last.id}".encode()).decode()
        return Page(items=[shown_as(shape, row) for row in records[: self.limit]], next=following)


ListingOf = Annotated[Listing, Depends()]


def shown_as(shape: type[Shape], row: object) -> Shape:
    """A row as the API shows it."""
    return shape.model_validate(row, from_attributes=True)


def row_of(db: Session, table: type[Row], row_id: str, thing: str) -> Row:
    """A row that must be there.

    Args:
        db: The database.
        table: The class of the row, which has `id`.
        row_id: Its id.
        thing: What it is, for the refusal.
    Raises:
        Problem: It is not there.
    """
    columns: Any = table
    row = db.scalar(select(table).where(columns.id == row_id))
    if row is None:
        raise not_found(thing, row_id)
    return row


def _key(cursor: str) -> tuple[str, str]:
    try:
        created, _, row_id = base64.urlsafe_b64decode(cursor).decode().partition(" ")
    except (binascii.Error, ValueError) as error:
        raise Problem(422, "cursor", "must be the `next` of a page", cursor, "query") from error
    return created, row_id


def audited(db: Session, request: Request, caller: Caller, action: str, target: str) -> None:
    """Note who changes what, in the transaction of the change."""
    entry = Audit(time=now(), user=caller.user, token_id=caller.token_id, action=action, target=target)
    entry.request_id = request.scope["request_id"]
    db.add(entry)


@dataclass(frozen=True)
class Change:
    """A change that a caller asks for."""

    request: Request
    core: CoreOf
    caller: Writer

    def note(self, db: Session, action: str, target: str) -> None:
        """Note it in its transaction."""
        audited(db, self.request, self.caller, action, target)


ChangeOf = Annotated[Change, Depends()]
UNCHANGED: dict[int | str, dict[str, Any]] = {304: {"description": "It has not changed."}}


def file_of(media_type: str, schema: Mapping[str, Any] = BINARY) -> dict[str, Any]:
    """Arguments of a route that answers with a file, which a client need not load again while it has not changed."""
    return {
        "response_class": Response,
        "responses": {200: {"content": {media_type: {"schema": dict(schema)}}}, **UNCHANGED},
    }


def with_etag(request: Request, tag: str, answer: Callable[[], Response]) -> Response:
    """An answer that a client need not load again while its tag is the same."""
    quoted = f'"{tag}"'
    known = [part.strip().removeprefix("W/") for part in request.headers.get("if-none-match", "").split(",")]
    response = Response(status_code=304) if quoted in known or "*" in known else answer()
    response.headers["ETag"] = quoted
    return response
