"""Bodies of requests, limited in size, in time, and in what all of them hold in memory together."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass

from starlette.datastructures import Headers
from starlette.types import Message, Receive

from estimator.service.problems import Problem
from estimator.service.settings import Settings

MOST_PUBLIC_BYTES = 10_000  # of a body without a token; a login sends a hundred
MOST_BODIES = 16  # of the greatest size, that all requests together may hold in memory
RETRY_AFTER_S = 5


@dataclass
class Body:
    """What of a request's body has arrived."""

    n_bytes: int = 0


class Bodies:
    """Limits of the bodies of all requests.

    Args:
        settings: Size of one, and the time in which it must arrive.
    """

    def __init__(self, settings: Settings) -> None:
        self._most, self._most_s = settings.most_body_bytes, settings.most_body_s
        self._n_held = 0  # bytes of all bodies

    def release(self, body: Body) -> None:
        """A request is over, and its body no longer in memory."""
        self._n_held -= body.n_bytes

    def limited(self, headers: Headers, receive: Receive, body: Body, is_public: bool) -> Receive:
        """A body that ends with a refusal where it is too long, takes too long, or is too much beside those of others."""
        if headers.get("content-encoding", "identity") != "identity":
            raise Problem(
                415, "body", "must not be encoded", headers["content-encoding"], "header Content-Encoding"
            )
        most_held, most_s = MOST_BODIES * self._most, self._most_s
        most = min(self._most, MOST_PUBLIC_BYTES) if is_public else self._most
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


def _too_long(most: int, length: object) -> Problem:
    return Problem(413, "body", f"must have at most {most} bytes", length)
