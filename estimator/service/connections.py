"""HTTP/1.1 of uvicorn, with strict heads, a time in which a request must arrive, and an end to the number of connections.

uvicorn waits for the first request of a connection, and for the rest of a head, as long as the client likes. Connections that send a byte a
minute ("slow loris") would use up the limit. So where the limit is reached, the connections that have waited longest are closed, and a
client that sends its request at once is answered beside any number of idle ones.
"""

from __future__ import annotations

import asyncio
import heapq
import ipaddress
import re
import resource
from collections import Counter
from collections.abc import Iterator
from typing import Any, Protocol, runtime_checkable

import h11
from h11._receivebuffer import (
    ReceiveBuffer,
)  # the only place where lines of heads and of trailers are told apart
from uvicorn.protocols.http.h11_impl import H11Protocol

MOST_HEAD_S = 10.0
MOST_CONNECTIONS = 1000  # a laboratory has tens
ROOM = 50  # that is made at once: to look at all connections takes milliseconds
MOST_BEFORE_REFUSAL = (
    MOST_CONNECTIONS + 200
)  # beyond, 503: so many requests are at work that nobody can be sent away
FILES = 4096  # that may be open at once: connections, journals, chunks
# A line feed alone ends no line, and a line that begins with a space continues none (RFC 9112, sections 2.2 and 5.2): a proxy in
# front may see another request there.
LOOSE_LINE = re.compile(rb"(?<!\r)\n|\n[ \t]")
# Seconds by which a connection counts as younger that has asked something before, or whose body is under way.
BONUS_USED_S, BONUS_BEGUN_S = 5.0, 30.0


@runtime_checkable
class Waiting(Protocol):
    """A connection from which the service may await something.

    Attributes:
        place: Of the client, as `place_of` has it.
        waits_since_s: Since when the service waits for the client, on the loop's clock; None while it does not.
        transport: What ends it.
    """

    place: str
    transport: asyncio.Transport

    @property
    def waits_since_s(self) -> float | None:
        """Since when the service waits for the client."""


class StrictLines(ReceiveBuffer):
    """Bytes that were received, whose heads and trailers have lines that end with CR LF and are not folded."""

    def maybe_extract_lines(self) -> list[bytearray] | None:
        """See h11; None where the head is not whole yet."""
        received = bytes(self)
        if not received.startswith(b"\r\n"):  # nothing but the end of a trailer
            head, end, _ = received.partition(b"\r\n\r\n")
            if LOOSE_LINE.search(head + end):
                raise h11.LocalProtocolError("lines of a head must end with CR LF and must not be folded")
        return super().maybe_extract_lines()

    def maybe_extract_next_line(self) -> bytearray | None:
        """See h11; the line that says how long a chunk is, in whose extension h11 takes a carriage return for a letter."""
        line: bytearray | None = super().maybe_extract_next_line()
        if line is not None and b"\r" in line[:-2]:
            raise h11.LocalProtocolError("a line must hold no carriage return before its end")
        return line


class PromptHttp(H11Protocol):
    """A connection that is closed where a request does not come, and sooner where its place is needed."""

    _awaited: asyncio.TimerHandle | None = None
    _waits_since_s = 0.0
    place = ""  # of the client
    waits_outside: Waiting | None = None  # what stood for it until its TLS handshake was over
    _has_asked = False

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.conn._receive_buffer = StrictLines()

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """See asyncio."""
        super().connection_made(transport)
        self.connections.discard(self.waits_outside)
        self.place = place_of(self.client[0] if self.client else "")
        self._await_head()
        if len(self.connections) > MOST_CONNECTIONS:
            make_room(self, self.connections)

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

    @property
    def waits_since_s(self) -> float | None:
        """Since when the client owes a request or the rest of it, with its bonus; None while the service owes an answer."""
        if self.conn.their_state is h11.IDLE:
            return self._waits_since_s + (BONUS_USED_S if self._has_asked else 0.0)
        return self._waits_since_s + BONUS_BEGUN_S if self.conn.their_state is h11.SEND_BODY else None

    def _await_head(self) -> None:
        """Start the clock where a head is awaited, or the rest of a body that was answered already; more letters do not start it anew."""
        state = self.conn.their_state
        is_awaited = state is h11.IDLE or (state is h11.SEND_BODY and self.conn.our_state is h11.DONE)
        self._has_asked |= state is not h11.IDLE
        if is_awaited and self._awaited is None:
            self._awaited = self.loop.call_later(MOST_HEAD_S, self.transport.close)
            self._waits_since_s = self.loop.time()
        elif not is_awaited and self._awaited is not None:
            self._awaited.cancel()
            self._awaited = None
            self._waits_since_s = self.loop.time()


def make_room(new: Waiting, connections: set[Any]) -> None:
    """Close the connections that have waited longest, of the address with most of them.

    Args:
        new: A connection that stays.
        connections: All of the service.
    """
    others: Iterator[Waiting] = (other for other in connections if other is not new)
    waiting = [(other, since_s) for other in others if (since_s := other.waits_since_s) is not None]
    n_of_place = Counter(other.place for other, _ in waiting)
    most = max(n_of_place.values(), default=0)
    crowd = [pair for pair in waiting if n_of_place[pair[0].place] == most]
    for other, _ in heapq.nsmallest(ROOM, crowd, key=lambda pair: pair[1]):
        connections.discard(other)  # now, and not when the loop comes to it
        other.transport.abort()


def place_of(address: str) -> str:
    """What one client cannot be more than one of: an address of IPv4, the first half of one of IPv6, whose other half it makes up.

    Examples:
        >>> place_of("192.0.2.1"), place_of("::ffff:192.0.2.1"), place_of("2001:db8:1:2:a:b:c:d")
        ('192.0.2.1', '192.0.2.1', '2001:db8:1:2::/64')
    """
    if ":" not in address:
        return address
    whole = ipaddress.IPv6Address(address.partition("%")[0])
    return str(whole.ipv4_mapped or ipaddress.IPv6Network((whole, 64), strict=False))


def allow_files() -> None:
    """Let the process open as many files as it needs for its connections, where the system permits it."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = FILES if hard == resource.RLIM_INFINITY else min(FILES, hard)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
