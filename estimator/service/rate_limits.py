"""How many requests a token or an address may make in a minute; memory of this process, so that a restart forgets."""

from __future__ import annotations

import math
import time

from limits import RateLimitItemPerMinute
from limits.storage import MemoryStorage
from limits.strategies import SlidingWindowCounterRateLimiter

from estimator.service.problems import Problem
from estimator.service.settings import Settings

ADMITTED, REFUSED, NOTED = "admitted", "refused", "noted"
MOST_NOTED = 60  # refusals of a token in a minute that the audit log takes


class RateLimits:
    """Counts requests by token, and by address those that have none; and by address those with a token that is not valid.

    Without tokens, at loopback, nothing is counted: the danger there is not a flood.
    """

    def __init__(self, settings: Settings) -> None:
        self._is_used = settings.needs_tokens
        self._limiter = SlidingWindowCounterRateLimiter(MemoryStorage())
        self._requests = RateLimitItemPerMinute(settings.most_requests_per_minute)
        self._noted = RateLimitItemPerMinute(MOST_NOTED)
        self._refusals = RateLimitItemPerMinute(settings.most_refused_per_minute)

    def count(self, caller: str) -> None:
        """Count a request of a token or an address.

        Raises:
            Problem: There were too many in the last minute.
        """
        if self._is_used and not self._limiter.hit(self._requests, ADMITTED, caller):
            raise self._problem(self._requests, ADMITTED, caller)

    def check_refused(self, address: str) -> None:
        """Refuse an address from which too many requests without a valid token came, before another token is looked up.

        Raises:
            Problem: There were too many in the last minute.
        """
        if self._is_used and not self._limiter.test(self._refusals, REFUSED, address):
            raise self._problem(self._refusals, REFUSED, address)

    def count_refused(self, address: str) -> None:
        """Count a request without a valid token."""
        self._limiter.hit(self._refusals, REFUSED, address)

    def is_noted(self, caller: str) -> bool:
        """Whether another refusal of a token goes into the audit log; counts it."""
        return self._limiter.hit(self._noted, NOTED, caller)

    def _problem(self, item: RateLimitItemPerMinute, *key: str) -> Problem:
        wait_s = max(1, math.ceil(self._limiter.get_window_stats(item, *key).reset_time - time.time()))
        rule = f"must be at most {item.amount} a minute" + (
            " without a valid token" if key[0] == REFUSED else ""
        )
        return Problem(429, "requests", rule, headers={"Retry-After": str(wait_s)})
