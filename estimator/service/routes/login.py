"""Logging in with a token, for the page: a browser cannot send headers with its event streams, but sends a cookie."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, Field

from estimator.service.logins import begin_login, end_login
from estimator.service.problems import Problem
from estimator.service.requests import CoreOf, JsonRoute, Reader, audited
from estimator.service.tokens import Scope, caller_of

router = APIRouter(route_class=JsonRoute, prefix="/v1", tags=["page"])


class Login(BaseModel, extra="forbid"):
    """A token."""

    token: Annotated[str, Field(min_length=1, max_length=200)]


class LoggedIn(BaseModel):
    """Who is logged in."""

    user: str
    scope: Scope


@router.post("/login")
def login(request: Request, response: Response, core: CoreOf, body: Login) -> LoggedIn:
    """Exchange a token for a cookie that this page's requests carry."""
    caller = caller_of(core.database, body.token.strip())
    if caller is None or caller.token_id is None:
        raise Problem(401, "token", "must be one that exists, has not expired and is not revoked")
    with core.database.writing() as db:
        login_id = begin_login(db, caller.token_id)
        audited(db, request, caller, "login", caller.token_id)
    core.cookies.put(response, login_id, request.url.scheme == "https")
    return LoggedIn(user=caller.user, scope=caller.scope)


@router.post("/logout", status_code=204)
def logout(request: Request, response: Response, core: CoreOf, caller: Reader) -> None:
    """End the login; its cookie, and every copy of it, is worth nothing from now on."""
    login_id = core.cookies.login_id(request.headers.get("cookie", ""))
    with core.database.writing() as db:
        if login_id is not None and (token_id := end_login(db, login_id)) is not None:
            audited(db, request, caller, "logout", token_id)
    core.cookies.remove(response, request.url.scheme == "https")
