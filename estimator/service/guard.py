"""What every request passes before a route sees it: name of the host, origin, token or cookie, rate, size and time of the body.

Refusal is the rule: a path without a token is one of `PUBLIC`, so a new route cannot be forgotten.
"""

from __future__ import annotations

import asyncio
import ipaddress
import logging
import re
import time
import uuid
from dataclasses import dataclass

from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from estimator.service.cookies import Cookies
from estimator.service.database import Database, now
from estimator.service.logins import caller_of_login
from estimator.service.metrics import NO_ROUTE, Metrics
from estimator.service.page_files import PAGE, page_files
from estimator.service.problems import Problem, answer_to, failure
from estimator.service.rate_limits import RateLimits
from estimator.service.schema import Audit
from estimator.service.settings import Settings
from estimator.service.storage import shortage
from estimator.service.tokens import NOBODY_ELSE, Caller, caller_of

LOGIN = "/v1/login"
PUBLIC = frozenset({"/healthz", "/readyz", LOGIN, *page_files()})
METHODS = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"})
SAFE = ("GET", "HEAD")
MOST_PUBLIC_BYTES = 10_000  # of a body from somebody who has not said who it is: a token has a hundred
MOST_BODIES = 16  # of the greatest size, that all requests together may hold in memory
RETRY_AFTER_S = 5
RECHECK_S = 10.0  # whether who follows a stream may still do so
LONGEST_TARGET = 200  # characters of a path in the audit log
# A name or an address, and a port.
HOST = re.compile(r"([^\s\[\]:/?#@\\]+|\[[0-9A-Fa-f:.]+\])(?::[0-9]{0,5})?")
LOOPBACK_NAMES = ("localhost", "127.0.0.1", "[::1]")
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
        self._n_held = 0  # bytes of all bodies
        own = LOOPBACK_NAMES if settings.is_loopback else (_bracketed(settings.host),)
        self._hosts = {name.lower() for name in (*own, *settings.allowed_hosts)}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        request_id = uuid.uuid4().hex
        scope["request_id"] = request_id

        begin_s = time.monotonic()
        has_begun = False
        body = _Body()

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
            self._n_held -= body.n_bytes

    async def _admitted(self, scope: Scope, receive: Receive, body: _Body) -> Receive:
        """Checks a request and returns the source of its body, limited in size and time; its caller is then in `scope`."""
        headers = Headers(scope=scope)
        _check_framing(scope, headers)
        self._check_site(scope, headers)
        address = scope["client"][0] if scope.get("client") else ""
        caller = scope["caller"] = await self._caller(scope, headers, address)
        if caller is not None and caller.token_id is not None:
            receive = self._while_admitted(scope, headers, receive)
        return self._limited(scope, headers, receive, body)

    def _note(self, scope: Scope, status: int, took_s: float) -> None:
        """Log and count a request whose answer begins; a token that is guessed at the login counts as one that is guessed elsewhere."""
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
        """Write into the audit log what a known caller was refused: the first ones of a minute, so that nobody fills the disk."""
        caller: Caller | None = scope.get("caller")
        if caller is None or not self._rates.is_noted(caller.token_id or caller.user):
            return
        try:
            entry = Audit(time=now(), user=caller.user, token_id=caller.token_id, action="refused")
            entry.request_id = scope["request_id"]
            entry.target = f"{scope['method']} {scope['path']}"[:LONGEST_TARGET]
            with self._database.writing() as db:
                db.add(entry)
        except Exception:  # the refusal itself must be told
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

    def _check_site(self, scope: Scope, headers: Headers) -> None:
        """Refuse what a page of another site makes a browser send: by its own name for this address, or across origins."""
        host = headers.get("host", "")
        written = HOST.fullmatch(host)
        name = host if written is None else written[1].lower()
        is_any = self._settings.host in ("0.0.0.0", "::") and _is_address(name)
        if written is None or (name not in self._hosts and not is_any):
            raise Problem(
                403, "host", "must be the service's address or one of allowed_hosts", name, "header Host"
            )
        origin = headers.get("origin")
        if origin is not None and origin != f"{scope['scheme']}://{host}":
            raise Problem(403, "origin", "must be the service itself", origin, "header Origin")
        # A link to the page, from a wiki.
        is_link = scope["path"] == PAGE and headers.get("sec-fetch-mode") == "navigate"
        if headers.get("sec-fetch-site", "none") not in ("none", "same-origin") and not is_link:
            raise Problem(
                403, "site", "must be the service itself", headers["sec-fetch-site"], "header Sec-Fetch-Site"
            )

    async def _caller(self, scope: Scope, headers: Headers, address: str) -> Caller | None:
        """Who asks; refused without a valid token, or with too many requests."""
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
        """Who the page belongs to. A browser says the origin of every change that it asks for, and it was checked."""
        if scope["method"] not in SAFE and "origin" not in headers:
            raise Problem(403, "origin", "must be given with a cookie", place="header Origin")
        login_id = self._cookies.login_id(cookie)
        caller = None
        if login_id is not None:
            caller = await run_in_threadpool(caller_of_login, self._database, login_id)
        if caller is None:
            raise Problem(401, "login", "must be recent, with a token that is still valid", headers=CHALLENGE)
        return caller

    def _limited(self, scope: Scope, headers: Headers, receive: Receive, body: _Body) -> Receive:
        """A body that ends with a refusal where it is too long, takes too long, or is too much beside those of others."""
        if headers.get("content-encoding", "identity") != "identity":
            raise Problem(
                415, "body", "must not be encoded", headers["content-encoding"], "header Content-Encoding"
            )
        most, most_s = self._settings.most_body_bytes, self._settings.most_body_s
        most_held = MOST_BODIES * most
        if scope["path"] in PUBLIC:
            most = min(most, MOST_PUBLIC_BYTES)
        length = headers.get("content-length", "0")
        if not (length.isascii() and length.isdecimal()) or int(length[:20]) > most:
            raise _too_long(most, length)
        is_whole = False
        end_s = asyncio.get_running_loop().time() + most_s

        async def limited() -> Message:
            nonlocal is_whole
            if is_whole:  # from here on it waits for the client to leave
                return await receive()
            try:
                async with asyncio.timeout_at(end_s):
                    message = await receive()
            except TimeoutError:
                raise Problem(408, "body", f"must arrive within {most_s:g} s") from None
            n = len(message.get("body", b""))
            body.n_bytes += n
            self._n_held += n
            is_whole = not message.get("more_body", False)
            if body.n_bytes > most:
                raise _too_long(most, body.n_bytes)
            if self._n_held > most_held:
                rule = f"must have at most {most_held} bytes together"
                raise Problem(
                    429, "bodies of all requests", rule, headers={"Retry-After": str(RETRY_AFTER_S)}
                )
            return message

        return limited


@dataclass
class _Body:
    """What of a request's body has arrived."""

    n_bytes: int = 0


def _check_framing(scope: Scope, headers: Headers) -> None:
    """Refuse a body whose end a proxy in front may see elsewhere, and with it a second request inside (RFC 9112, section 6.1).

    h11 would go by Transfer-Encoding, which is allowed, and keep the connection open, which is not.
    """
    if "transfer-encoding" not in headers:
        return
    is_old = scope.get("http_version") == "1.0"
    if is_old or "content-length" in headers:
        rule = "must not be given in HTTP/1.0" if is_old else "must not stand beside Content-Length"
        raise Problem(
            400, "Transfer-Encoding", rule, place="header Transfer-Encoding", headers={"Connection": "close"}
        )


def _too_long(most: int, length: object) -> Problem:
    return Problem(413, "body", f"must have at most {most} bytes", length)


def _bracketed(host: str) -> str:
    return f"[{host}]" if ":" in host else host


def _is_address(name: str) -> bool:
    """Whether a host is a plain address, which no page of another site can make its own name for."""
    try:
        ipaddress.ip_address(name.strip("[]"))
    except ValueError:
        return False
    return True
