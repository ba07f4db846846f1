"""Requests: the caller, limits of what is at work at once, bodies, and the audit log."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Coroutine, Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import Depends, Header, Path, Request
from fastapi.routing import APIRoute, APIRouter
from pydantic import Field
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
LARGEST_SEED = 2**32 - 1
BINARY: Mapping[str, Any] = {"type": "string", "format": "binary"}
Seed = Annotated[int, Field(ge=0, le=LARGEST_SEED, description="Of everything random.")]


def core_of(request: Request) -> Core:
    """The core of the application."""
    return request.app.state.core


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


def router_of(prefix: str, *tags: str, scope: Scope = Scope.READ) -> APIRouter:
    """A router whose routes ask for a scope at least."""
    return APIRouter(route_class=JsonRoute, prefix=prefix, tags=[*tags], dependencies=[Depends(Needs(scope))])


def _streaming(core: CoreOf, caller: Reader) -> Iterator[None]:
    with core.streams.taken(caller.user):
        yield


STREAM = Depends(_streaming)
"""Dependency of routes with event streams, of which some run at once. What such a route refuses has to be refused by what it depends on:
once it runs, the answer has begun."""


def turn(limit: str) -> Any:
    """A dependency by which a request waits for its turn at a limit of the core, such as `importing`."""

    async def waits(core: CoreOf) -> AsyncIterator[None]:
        async with getattr(core, limit).taken():
            yield

    return Depends(waits)


Importing = Annotated[None, turn("importing")]
"""Dependency of routes that read a whole session, of which few run at once; stands after the body, so that a client that sends slowly is
not among them."""


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
    """A request with JSON that is read by the loader of all JSON."""

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


def audited(db: Session, request: Request, caller: Caller, action: str, target: str) -> None:
    """Write a change into the audit log, in its transaction."""
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
