"""Carries out calls over httpx: `Connection` waits for each step, `AsyncConnection` awaits it."""

from __future__ import annotations

import asyncio
import time
from contextlib import suppress
from typing import Any

import httpx

from estimator.client.steps import Attempts, Listen, Send, Step, Steps, T, Wait, Work

TIMEOUT_S = 120.0


class Connection:
    """A connection that waits.

    Args:
        url: Address of the service.
        token: Token, where the service needs one.
        transport: Another transport of httpx.
        attempts: How often a request is made while the service does not answer.
    """

    def __init__(
        self, url: str, token: str | None, transport: httpx.BaseTransport | None, attempts: int
    ) -> None:
        self._attempts = attempts
        self._http = httpx.Client(
            base_url=url, headers=_headers(token), timeout=TIMEOUT_S, transport=transport
        )

    def close(self) -> None:
        """Close the connections to the service."""
        self._http.close()

    def run(self, steps: Steps[T]) -> T:
        """Carry out a call.

        Raises:
            InvalidInput: The service refuses it; the message is its sentence.
            ServiceFault: The service cannot be reached, or fails.
        """
        outcome: Any = None
        while True:
            try:
                step = steps.send(outcome)
            except StopIteration as end:
                result: T = end.value
                return result
            outcome = self._outcome(step)

    def _outcome(self, step: Step) -> Any:
        match step:
            case Wait():
                time.sleep(step.pause_s)
                return None
            case Work():
                return step.function()
        attempts = Attempts(str(self._http.base_url), self._attempts)
        while True:
            answer = self._answer(step)
            pause_s = attempts.pause_s(answer)
            if pause_s is None:
                return answer
            time.sleep(pause_s)

    def _answer(self, step: Send | Listen) -> httpx.Response | httpx.TransportError:
        try:
            if isinstance(step, Send):
                return self._http.request(step.method, step.path, **step.call)
            with self._http.stream("GET", step.path, headers=dict(step.headers)) as answer:
                if not answer.is_success:
                    answer.read()
                    return answer
                with suppress(httpx.TransportError):
                    for line in answer.iter_lines():
                        step.take(line)
                return answer
        except httpx.TransportError as error:
            return error


class AsyncConnection:
    """A connection that awaits.

    Args:
        url, token, attempts: As of `Connection`.
        transport: Another asynchronous transport of httpx.
    """

    def __init__(
        self, url: str, token: str | None, transport: httpx.AsyncBaseTransport | None, attempts: int
    ) -> None:
        self._attempts = attempts
        self._http = httpx.AsyncClient(
            base_url=url, headers=_headers(token), timeout=TIMEOUT_S, transport=transport
        )

    async def close(self) -> None:
        """Close the connections to the service."""
        await self._http.aclose()

    async def run(self, steps: Steps[T]) -> T:
        """Carry out a call, as `Connection.run` does."""
        outcome: Any = None
        while True:
            try:
                step = steps.send(outcome)
            except StopIteration as end:
                result: T = end.value
                return result
            outcome = await self._outcome(step)

    async def _outcome(self, step: Step) -> Any:
        match step:
            case Wait():
                await asyncio.sleep(step.pause_s)
                return None
            case Work():
                return await asyncio.to_thread(step.function)
        attempts = Attempts(str(self._http.base_url), self._attempts)
        while True:
            answer = await self._answer(step)
            pause_s = attempts.pause_s(answer)
            if pause_s is None:
                return answer
            await asyncio.sleep(pause_s)

    async def _answer(self, step: Send | Listen) -> httpx.Response | httpx.TransportError:
        try:
            if isinstance(step, Send):
                return await self._http.request(step.method, step.path, **step.call)
            async with self._http.stream("GET", step.path, headers=dict(step.headers)) as answer:
                if not answer.is_success:
                    await answer.aread()
                    return answer
                with suppress(httpx.TransportError):
                    async for line in answer.aiter_lines():
                        step.take(line)
                return answer
        except httpx.TransportError as error:
            return error


def _headers(token: str | None) -> dict[str, str]:
    return {} if token is None else {"Authorization": f"Bearer {token}"}
