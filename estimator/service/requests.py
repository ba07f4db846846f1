"""What routes have in common: who asks, bodies that are not JSON, pages of lists, ETags, and the audit log."""

from __future__ import annotations

import base64
import binascii
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator
from typing import Annotated, Any, Generic, TypeVar

from fastapi import Depends, Header, Path, Query, Request
from fastapi.routing import APIRoute
from pydantic import BaseModel, Field
from sqlalchemy import Select, tuple_
from sqlalchemy.orm import Session
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from estimator.json_files import json_of
from estimator.service.core import Core
from estimator.service.database import now
from estimator.service.problems import Problem
from estimator.service.schema import Audit
from estimator.service.tokens import Caller, Scope

ID = r"^[0-9a-f]{32}$"
MOST_ITEMS, ITEMS = 500, 50
LARGEST_SEED = 2**32 - 1
Item = TypeVar("Item")
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
    with core.stream(caller.user):
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
    schema = {"type": "string", "minLength": 1}
    if media_type == "application/zip":
        schema = {"type": "string", "format": "binary"}
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


def page_of(
    db: Session, rows: Select[Any], table: Any, limit: int, cursor: str | None, shape: Callable[[Any], Item]
) -> Page[Item]:
    """A page of the rows of a table, which has `created` and `id`."""
    key = tuple_(table.created, table.id)
    if cursor is not None:
        rows = rows.where(key < _key(cursor))
    records = list(db.scalars(rows.order_by(table.created.desc(), table.id.desc()).limit(limit + 1)))
    last = records[limit - 1] if len(records) > limit else None
    following = (
        None if last is None else base64.urlsafe_b64encode(f"{last.created} {last.id}".encode()).decode()
    )
    return Page(items=[shape(row) for row in records[:limit]], next=following)


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


def with_etag(request: Request, tag: str, answer: Callable[[], Response]) -> Response:
    """An answer that a client need not load again while its tag is the same."""
    quoted = f'"{tag}"'
    known = [part.strip().removeprefix("W/") for part in request.headers.get("if-none-match", "").split(",")]
    response = Response(status_code=304) if quoted in known or "*" in known else answer()
    response.headers["ETag"] = quoted
    return response
