"""Limits of what is at work at once: one that refuses more, and one that lets some wait."""

from __future__ import annotations

import asyncio
import math
import threading
from collections import Counter
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager

from estimator.service.problems import check_limits

RETRY_AFTER_S = 10


class RefusingLimit:
    """At most so many at once, in any number of threads; more are refused.

    Args:
        thing: What they are, in words.
        most: All at once.
        most_of_user: Those of one user.
        retry_after_s: When a refusal says that it may be asked again.
    """

    def __init__(
        self, thing: str, most: int, most_of_user: float = math.inf, retry_after_s: int = RETRY_AFTER_S
    ) -> None:
        self._thing, self._most, self._most_of_user = thing, most, most_of_user
        self._retry_after_s, self._counting = retry_after_s, threading.Lock()
        self._taken: Counter[str] = Counter()

    def n_taken(self) -> int:
        """Number of those at work."""
        return self._taken.total()

    @contextmanager
    def taken(self, user: str = "") -> Iterator[None]:
        """One of them, for a user.

        Raises:
            Problem: There are too many.
        """
        with self._counting:
            limits = {
                self._thing: (self.n_taken(), self._most),
                f"{self._thing} of {user}": (self._taken[user], self._most_of_user),
            }
            check_limits(limits, 429, "must be at most {} at once", self._retry_after_s)
            self._taken[user] += 1
        try:
            yield
        finally:
            with self._counting:
                self._taken[user] -= 1
                self._taken += Counter()  # forgets users without one


class WaitingLimit:
    """A few requests at once that take much memory; others wait for their turn, without a thread meanwhile.

    Args:
        thing: What they are, in words.
        most: Requests that are at work at once.
        most_waiting: Requests that wait; more are refused.
    """

    def __init__(self, thing: str, most: int, most_waiting: int) -> None:
        self._thing, self._most_waiting, self._n_waiting = thing, most_waiting, 0
        self._turns = asyncio.Semaphore(most)

    @asynccontextmanager
    async def taken(self) -> AsyncIterator[None]:
        """One of them, as soon as it may begin.

        Raises:
            Problem: Too many wait already.
        """
        limits = {self._thing: (self._n_waiting, self._most_waiting)}
        check_limits(limits, 429, "must be at most {} that wait", RETRY_AFTER_S)
        self._n_waiting += 1
        try:
            await self._turns.acquire()
        finally:
            self._n_waiting -= 1
        try:
            yield
        finally:
            self._turns.release()
