"""What every request passes before a route sees it: name of the host, origin, token or cookie, rate, size and time of the body.

Refusal is the rule: a path without a token is one of `PUBLIC`, so a new route cannot be forgotten.
"""

from __future__ import annotations

import asyncio
import logging
import time
import uuid

from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from estimator.service.bodies import Bodies, Body
from estimator.service.database import Database, now
from estimator.service.logins import Cookies, caller_of_login
from estimator.service.metrics import NO_ROUTE, Metrics
from estimator.service.page_files import page_files
from estimator.service.problems import Problem, answer_to, failure
from estimator.service.rate_limits import RateLimits
from estimator.service.schema import Audit
from estimator.service.settings import Settings
from estimator.service.site import Site, check_framing
from estimator.service.storage import shortage
from estimator.service.tokens import NOBODY_ELSE, Caller, caller_of

LOGIN = "/v1/login"
PUBLIC = frozenset({"/healthz", "/readyz", LOGIN, *page_files()})
METHODS = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"})
SAFE = ("GET", "HEAD")
RECHECK_S = 10.0  # whether the caller of a stream may still read it
LONGEST_TARGET = 200  # characters of a path in the audit log
SECURITY_HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "private, no-cache",
}
DEFAULT_POLICY = "default-src 'none'; frame-ancestors 'none'"
CHALLENGE = {"WWW-Authenticate": 'Bearer realm="coilcal"'}
log = logging.getLogger("coilcal.service")


class Guard:
    """Admits requests, gives each an id, and puts the headers of security on the answers."""

    def __init__(
        self, app: ASGIApp, settings: Settings, database: Database, cookies: Cookies, metrics: Metrics
    ) -> None:
        self._app, self._settings, self._database, self._metrics = app, settings, database, metrics
        self._cookies, self._rates = cookies, RateLimits(settings)
        self._site, self._bodies = Site(settings), Bodies(settings)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        request_id = uuid.uuid4().hex
        scope["request_id"] = request_id

        begin_s = time.monotonic()
        has_begun = False
        body = Body()

        async def send_with_headers(message: Message) -> None:
            nonlocal has_begun
            if message["type"] == "http.response.start":
                has_begun = True
                if message["status"] == 403:
                    await run_in_threadpool(self._note_refusal, scope)
                self._note(scope, message["status"], time.monotonic() - begin_s)
                headers = MutableHeaders(scope=message)
                headers["X-Request-ID"] = request_id
                headers.setdefault("Content-Security-Policy", DEFAULT_POLICY)
                for name, value in SECURITY_HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        try:
            try:
                limited = await self._admitted(scope, receive, body)
            except Problem as problem:
                await answer_to(problem, request_id)(scope, receive, send_with_headers)
                return
            await self._app(scope, limited, send_with_headers)
        except Exception as error:  # here, and not in Starlette's outermost layer, so that it is counted and has the headers too
            if has_begun:
                raise
            log.error("a request failed", exc_info=error, extra={"request_id": request_id})
            await answer_to(shortage(error) or failure(), request_id)(scope, receive, send_with_headers)
        finally:
            self._bodies.release(body)

    async def _admitted(self, scope: Scope, receive: Receive, body: Body) -> Receive:
        """Checks a request and returns the source of its body, limited in size and time; its caller is then in `scope`."""
        headers = Headers(scope=scope)
        check_framing(scope, headers)
        self._site.check(scope, headers)
        address = scope["client"][0] if scope.get("client") else ""
        caller = scope["caller"] = await self._caller(scope, headers, address)
        if caller is not None and caller.token_id is not None:
            receive = self._while_admitted(scope, headers, receive)
        return self._bodies.limited(headers, receive, body, scope["path"] in PUBLIC)

    def _note(self, scope: Scope, status: int, took_s: float) -> None:
        """Log and count a request whose answer begins; a wrong token at the login counts as one at any other route."""
        if scope["path"] == LOGIN and status == 401:
            self._rates.count_refused(scope["client"][0] if scope.get("client") else "")
        caller = scope.get("caller")
        told = {"request_id": scope["request_id"], "method": scope["method"], "path": scope["path"]}
        told |= {"status": status, "user": None if caller is None else caller.user}
        log.info("request", extra={**told, "took_s": round(took_s, 4)})
        route = getattr(scope.get("route"), "path", NO_ROUTE)
        method = scope["method"] if scope["method"] in METHODS else NO_ROUTE
        self._metrics.answered(method, route, status, took_s)

    def _note_refusal(self, scope: Scope) -> None:
        """Write into the audit log what a known caller was refused: the first ones of a minute, so that the disk cannot be filled."""
        caller: Caller | None = scope.get("caller")
        if caller is None or not self._rates.is_noted(caller.token_id or caller.user):
            return
        try:
            entry = Audit(time=now(), user=caller.user, token_id=caller.token_id, action="refused")
            entry.request_id = scope["request_id"]
            entry.target = f"{scope['method']} {scope['path']}"[:LONGEST_TARGET]
            with self._database.writing() as db:
                db.add(entry)
        except Exception:  # the refusal itself must be sent
            log.exception("a refusal could not be noted", extra={"request_id": scope["request_id"]})

    def _while_admitted(self, scope: Scope, headers: Headers, receive: Receive) -> Receive:
        """A source that ends a request, as a client that leaves does, when its token or login has ended: streams last for hours."""

        async def admitted() -> Message:
            while True:
                try:
                    async with asyncio.timeout(RECHECK_S):
                        return await receive()
                except TimeoutError:
                    try:
                        await self._known_caller(scope, headers)
                    except Problem:
                        return {"type": "http.disconnect"}

        return admitted

    async def _caller(self, scope: Scope, headers: Headers, address: str) -> Caller | None:
        """The caller; refused without a valid token, or with too many requests."""
        if scope["path"] in PUBLIC:
            if scope["path"] == LOGIN:
                self._rates.check_refused(address)
            self._rates.count(address)
            return None
        self._rates.check_refused(address)
        try:
            caller = await self._known_caller(scope, headers)
        except Problem:
            self._rates.count_refused(address)
            raise
        self._rates.count(caller.token_id or address)
        return caller

    async def _known_caller(self, scope: Scope, headers: Headers) -> Caller:
        kind, _, secret = headers.get("authorization", "").partition(" ")
        if not self._settings.needs_tokens and not secret:
            return NOBODY_ELSE
        cookie = headers.get("cookie", "")
        if not kind and self._cookies.name in cookie:
            return await self._caller_by_cookie(scope, headers, cookie)
        if kind.lower() != "bearer" or not secret:
            raise Problem(
                401, "token", "must be given", place="header Authorization: Bearer", headers=CHALLENGE
            )
        caller = await run_in_threadpool(caller_of, self._database, secret.strip())
        if caller is None:
            raise Problem(
                401, "token", "must be one that exists, has not expired and is not revoked", headers=CHALLENGE
            )
        return caller

    async def _caller_by_cookie(self, scope: Scope, headers: Headers, cookie: str) -> Caller:
        """The caller of a request with the cookie of the page. A browser sends the origin of every change, which was checked."""
        if scope["method"] not in SAFE and "origin" not in headers:
            raise Problem(403, "origin", "must be given with a cookie", place="header Origin")
        login_id = self._cookies.login_id(cookie)
        caller = None
        if login_id is not None:
            caller = await run_in_threadpool(caller_of_login, self._database, login_id)
        if caller is None:
            raise Problem(401, "login", "must be recent, with a token that is still valid", headers=CHALLENGE)
        return caller
