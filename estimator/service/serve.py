"""Starts the service: checks what it needs, binds its address, says it, and serves until a signal comes."""

from __future__ import annotations

import socket
import threading
import webbrowser
from collections.abc import Callable
from types import FrameType

import uvicorn
from fastapi import FastAPI

from estimator.errors import InvalidInput, reason
from estimator.service.app import create_app
from estimator.service.connections import MOST_BEFORE_REFUSAL, allow_files
from estimator.service.core import DATABASE, Core
from estimator.service.database import Database, now
from estimator.service.logs import install_logs
from estimator.service.settings import KEYS, Settings
from estimator.service.tls import http_of
from estimator.service.tokens import all_tokens

GRACE_S = 10  # for answers that are under way when the service is told to end
BACKLOG = 512


def serve(settings: Settings, tell: Callable[[str], None], opens: bool = False) -> None:
    """Serve until SIGINT or SIGTERM; jobs that run then go on at the next start.

    Args:
        settings: How to serve.
        tell: Called with the address, once requests to it are answered.
        opens: Show the page in this computer's browser.
    Raises:
        InvalidInput: Tokens are needed and there are none, or the address, the data folder or the certificate cannot be used.
    """
    _check_tokens(settings)
    install_logs()
    allow_files()
    listener = _bound(settings)
    try:
        app = create_app(settings)
        config = config_of(app, settings)
    except BaseException:
        listener.close()
        raise
    address = address_of(settings, listener.getsockname()[1])
    tell(address)
    if opens:
        threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()
    _Server(config, app.state.core).run(sockets=[listener])


class _Server(uvicorn.Server):
    """Ends event streams when the signal comes: uvicorn would first wait for them until `GRACE_S` is over, and then cut them."""

    def __init__(self, config: uvicorn.Config, core: Core) -> None:
        super().__init__(config)
        self._core = core

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """See uvicorn."""
        self._core.end_streams()
        super().handle_exit(sig, frame)


def config_of(app: FastAPI, settings: Settings) -> uvicorn.Config:
    """How uvicorn serves the application."""
    return uvicorn.Config(
        app,
        http=http_of(settings),  # type: ignore[arg-type]  # it only calls what it is given
        limit_concurrency=MOST_BEFORE_REFUSAL,
        log_config=None,
        access_log=False,
        server_header=False,
        proxy_headers=False,
        ws="none",
        timeout_graceful_shutdown=GRACE_S,
    )


def plan_of(settings: Settings) -> dict[str, object]:
    """What `serve` would do with these settings, as far as can be said without doing it.

    Raises:
        InvalidInput: It would refuse to start.
    """
    _check_tokens(settings)
    http_of(settings)
    return {
        "address": address_of(settings, settings.port),
        "tokens": f"needed; {_n_tokens(settings)} are valid" if settings.needs_tokens else "not needed",
        "workers": settings.scheduler or f"{settings.n_workers} process{'es' * (settings.n_workers != 1)}",
        "settings": {key: str(getattr(settings, key)) for key in KEYS},
    }


def address_of(settings: Settings, port: int) -> str:
    """URL at which the service is reached."""
    scheme = "https" if settings.tls_certificate else "http"
    host = f"[{settings.host}]" if ":" in settings.host else settings.host
    return f"{scheme}://{host}:{port or 'a free port'}"


def _check_tokens(settings: Settings) -> None:
    if settings.needs_tokens and not _n_tokens(settings):
        why = f"because {settings.host} is not loopback"
        if settings.is_loopback:
            why = "because a proxy is named" if settings.proxies else "because require_tokens is set"
        raise InvalidInput(
            f"tokens must be there before the service starts, {why}; there is none in {settings.data} "
            "(coilcal serve token create makes one)"
        )


def _n_tokens(settings: Settings) -> int:
    path = settings.data / DATABASE
    if not path.is_file():
        return 0
    database = Database(path)
    try:
        database.migrate()
        return sum(token.revoked is None and token.expires > now() for token in all_tokens(database))
    finally:
        database.close()


def _bound(settings: Settings) -> socket.socket:
    """A socket that takes connections at once; they are answered when the application has started."""
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    try:
        listener = socket.create_server((settings.host, settings.port), family=family, backlog=BACKLOG)
        # asyncio does this only for sockets of its own; without, small answers wait 40 ms for the client's acknowledgement.
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return listener
    except OSError as error:
        raise InvalidInput(
            f"address must be free and one of this computer; {settings.host} port {settings.port} is not: {reason(error)}"
        ) from error
