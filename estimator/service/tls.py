"""TLS below HTTP: a handshake that does not come holds the place of a connection no longer than a request that does not come.

uvicorn leaves the handshake to asyncio, which waits for it for a minute and does not report the connection before it is over, so that
silent clients would hold all files that the process may open.
"""

from __future__ import annotations

import asyncio
import ssl
from asyncio.sslproto import SSLProtocol
from collections.abc import Callable
from typing import Any, cast

from estimator.errors import InvalidInput, reason
from estimator.service.connections import MOST_CONNECTIONS, MOST_HEAD_S, PromptHttp, make_room, place_of
from estimator.service.settings import Settings


def http_of(settings: Settings) -> Callable[..., asyncio.BaseProtocol]:
    """What uvicorn makes for each connection: HTTP, inside of TLS where there is a certificate.

    Raises:
        InvalidInput: Certificate or key cannot be used.
    """
    if not settings.tls_certificate:
        return PromptHttp
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    try:
        context.load_cert_chain(settings.tls_certificate, settings.tls_key, lambda: b"")
    except OSError as error:  # of the files, or of what is in them
        why = error.reason if isinstance(error, ssl.SSLError) else reason(error)
        words = (
            "tls_certificate and tls_key must be PEM files of a certificate and of its key without a password"
        )
        raise InvalidInput(
            f"{words}; received {settings.tls_certificate} and {settings.tls_key}: {why}"
        ) from error

    def made(*args: Any, **kwargs: Any) -> PromptTls:
        return PromptTls(PromptHttp(*args, **kwargs), context)

    return made


class PromptTls(SSLProtocol):
    """A connection that counts among the others from its beginning, and is one of HTTP once its handshake is over."""

    def __init__(self, http: PromptHttp, context: ssl.SSLContext) -> None:
        super().__init__(
            http.loop,
            http,
            context,
            None,  # type: ignore[arg-type]  # nobody waits for the handshake
            server_side=True,
            ssl_handshake_timeout=MOST_HEAD_S,  # type: ignore[arg-type]  # fractions of a second too
            ssl_shutdown_timeout=MOST_HEAD_S,
        )
        self._http = http
        self.place, self.waits_since_s = "", http.loop.time()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """See asyncio."""
        self.transport = cast("asyncio.Transport", transport)
        self.place = place_of((transport.get_extra_info("peername") or [""])[0])
        self._http.waits_outside = self
        connections = self._http.connections
        connections.add(self)  # type: ignore[arg-type]  # uvicorn calls nothing but `shutdown`
        super().connection_made(transport)
        if len(connections) > MOST_CONNECTIONS:
            make_room(self, connections)

    def connection_lost(self, exc: BaseException | None) -> None:
        """See asyncio."""
        self._http.connections.discard(self)
        super().connection_lost(exc)

    def shutdown(self) -> None:
        """End it, for the service ends."""
        self.transport.abort()
