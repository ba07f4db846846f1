"""HTTP/1.1 of uvicorn, with a time in which the head of a request must have arrived.

uvicorn waits for the first request of a connection, and for the rest of a head, as long as the client likes. A few hundred connections that
say a letter a minute ("slow loris") would hold all files that the process may open.
"""

from __future__ import annotations

import asyncio
import resource

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

MOST_HEAD_S = 20.0
MOST_CONNECTIONS = 1000  # beyond, 503; a laboratory has tens
FILES = 4096  # that may be open at once: connections, journals, chunks


class PromptHttp(H11Protocol):
    """A connection that is closed where the head of a request does not come."""

    _awaited: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """See asyncio."""
        super().connection_made(transport)
        self._await_head()

    def data_received(self, data: bytes) -> None:
        """See asyncio."""
        super().data_received(data)
        self._await_head()

    def on_response_complete(self) -> None:
        """See uvicorn."""
        super().on_response_complete()
        self._await_head()

    def connection_lost(self, exc: Exception | None) -> None:
        """See asyncio."""
        if self._awaited is not None:
            self._awaited.cancel()
        super().connection_lost(exc)

    def _await_head(self) -> None:
        """Start the clock where a head is awaited, and stop it where one has come; more letters of it do not start it anew."""
        is_awaited = self.conn.their_state is h11.IDLE
        if is_awaited and self._awaited is None:
            self._awaited = self.loop.call_later(MOST_HEAD_S, self.transport.close)
        elif not is_awaited and self._awaited is not None:
            self._awaited.cancel()
            self._awaited = None


def allow_files() -> None:
    """Let the process open as many files as it needs for its connections, where the system permits it."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = FILES if hard == resource.RLIM_INFINITY else min(FILES, hard)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
