"""Room for a few requests at once that take much memory; others wait for their turn, and hold up no thread meanwhile."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from estimator.service.problems import Problem

RETRY_AFTER_S = 10


class Room:
    """Admits some requests at once.

    Args:
        thing: What they are, in words.
        most: Requests that are at work at once.
        most_waiting: Requests that wait; more are refused.
    """

    def __init__(self, thing: str, most: int, most_waiting: int) -> None:
        self._thing, self._most_waiting, self._n_waiting = thing, most_waiting, 0
        self._places = asyncio.Semaphore(most)

    @asynccontextmanager
    async def taken(self) -> AsyncIterator[None]:
        """A place, as soon as one is free.

        Raises:
            Problem: Too many wait already.
        """
        if self._n_waiting >= self._most_waiting:
            rule = f"must be at most {self._most_waiting} that wait"
            raise Problem(429, self._thing, rule, headers={"Retry-After": str(RETRY_AFTER_S)})
        self._n_waiting += 1
        try:
            await self._places.acquire()
        finally:
            self._n_waiting -= 1
        try:
            yield
        finally:
            self._places.release()
