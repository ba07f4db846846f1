"""Requests over httpx, made again while the service is busy or away, and lists that come page by page.

Calls are coroutines that use four primitives: a request, a stream of lines, a pause, and work in this process. `AsyncConnection` awaits
them. On a `Connection` each is done when it is awaited, so that `run` carries a call out without an event loop.
"""

from __future__ import annotations

import asyncio
import time
from abc import ABC, abstractmethod
from collections.abc import AsyncGenerator, Awaitable, Callable, Coroutine, Mapping
from contextlib import suppress
from itertools import count
from typing import Any, TypeVar

import httpx

from estimator.errors import CoilcalError, InvalidInput

T = TypeVar("T")
Lines = Callable[[str], None]
TIMEOUT_S = 120.0
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.5, 30.0
BUSY = (408, 429, 503)  # the same request may be accepted in a moment


class ServiceFault(CoilcalError):
    """The service cannot be reached, or failed."""


class JobFailed(CoilcalError):
    """A job ended without a result; the message is the sentence of the service."""


class Http(ABC):
    """What calls use.

    Args:
        http: Client of httpx.
        attempts: How often a request is made while the service does not answer.
    """

    def __init__(self, http: httpx.Client | httpx.AsyncClient, attempts: int) -> None:
        self._url, self._attempts = str(http.base_url), attempts

    async def send(self, method: str, path: str, **call: Any) -> httpx.Response:
        """The answer to a request; `call` has further arguments of httpx.

        Raises:
            InvalidInput: The service refuses it; the message is its sentence.
            ServiceFault: It cannot be reached, or fails.
        """
        return await self._answered(lambda: self._request(method, path, call))

    async def json(self, method: str, path: str, **call: Any) -> dict[str, Any]:
        """The JSON object that answers a request; errors as of `send`."""
        return dict((await self.send(method, path, **call)).json())

    async def listen(self, path: str, headers: Mapping[str, str], take: Lines) -> None:
        """Pass the lines of a stream to `take`, until the service ends it or the connection breaks; errors as of `send`."""
        await self._answered(lambda: self._stream(path, headers, take))

    async def _answered(self, ask: Callable[[], Awaitable[httpx.Response]]) -> httpx.Response:
        for attempt in count(1):
            pause_s = min(FIRST_PAUSE_S * 2.0 ** (attempt - 1), LONGEST_PAUSE_S)
            try:
                answer = await ask()
            except httpx.TransportError as error:
                fault = f"service must answer; {self._url} does not: {error}"
            else:
                if answer.is_success:
                    return answer
                fault = sentence(answer)
                if answer.status_code not in BUSY:
                    raise (ServiceFault if answer.is_server_error else InvalidInput)(fault)
                after = answer.headers.get("retry-after", "")
                if after.isdecimal():
                    pause_s = min(float(after), LONGEST_PAUSE_S)  # the service knows better
            if attempt >= self._attempts:
                raise ServiceFault(fault)
            await self.pause(pause_s)
        raise AssertionError("the loop above has no end")

    @abstractmethod
    def run(self, call: Coroutine[Any, Any, T]) -> Any:
        """The result of a call, or what is awaited for it."""

    @abstractmethod
    async def pause(self, pause_s: float) -> None:
        """Wait."""

    @abstractmethod
    async def work(self, function: Callable[[], T]) -> T:
        """The result of a function that takes long in this process."""

    @abstractmethod
    async def _request(self, method: str, path: str, call: Mapping[str, Any]) -> httpx.Response: ...

    @abstractmethod
    async def _stream(self, path: str, headers: Mapping[str, str], take: Lines) -> httpx.Response: ...


class Connection(Http):
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
        self._http = httpx.Client(
            base_url=url, headers=_headers(token), timeout=TIMEOUT_S, transport=transport
        )
        super().__init__(self._http, attempts)

    def close(self) -> None:
        """Close the connections to the service."""
        self._http.close()

    def run(self, call: Coroutine[Any, Any, T]) -> T:
        """The result of a call, which no primitive suspends."""
        try:
            call.send(None)
        except StopIteration as end:
            return end.value
        raise RuntimeError("a call must await nothing but its connection")

    async def pause(self, pause_s: float) -> None:
        """Wait."""
        time.sleep(pause_s)

    async def work(self, function: Callable[[], T]) -> T:
        """The result of a function."""
        return function()

    async def _request(self, method: str, path: str, call: Mapping[str, Any]) -> httpx.Response:
        return self._http.request(method, path, **call)

    async def _stream(self, path: str, headers: Mapping[str, str], take: Lines) -> httpx.Response:
        with self._http.stream("GET", path, headers=dict(headers)) as answer:
            if not answer.is_success:
                answer.read()
                return answer
            with suppress(httpx.TransportError):
                for line in answer.iter_lines():
                    take(line)
            return answer


class AsyncConnection(Http):
    """A connection that awaits.

    Args:
        url, token, attempts: As of `Connection`.
        transport: Another asynchronous transport of httpx.
    """

    def __init__(
        self, url: str, token: str | None, transport: httpx.AsyncBaseTransport | None, attempts: int
    ) -> None:
        self._http = httpx.AsyncClient(
            base_url=url, headers=_headers(token), timeout=TIMEOUT_S, transport=transport
        )
        super().__init__(self._http, attempts)

    async def close(self) -> None:
        """Close the connections to the service."""
        await self._http.aclose()

    def run(self, call: Coroutine[Any, Any, T]) -> Coroutine[Any, Any, T]:
        """The call itself, to be awaited."""
        return call

    async def pause(self, pause_s: float) -> None:
        """Wait."""
        await asyncio.sleep(pause_s)

    async def work(self, function: Callable[[], T]) -> T:
        """The result of a function, from another thread."""
        return await asyncio.to_thread(function)

    async def _request(self, method: str, path: str, call: Mapping[str, Any]) -> httpx.Response:
        return await self._http.request(method, path, **call)

    async def _stream(self, path: str, headers: Mapping[str, str], take: Lines) -> httpx.Response:
        async with self._http.stream("GET", path, headers=dict(headers)) as answer:
            if not answer.is_success:
                await answer.aread()
                return answer
            with suppress(httpx.TransportError):
                async for line in answer.aiter_lines():
                    take(line)
            return answer


def sentence(answer: httpx.Response) -> str:
    """What a refusal says."""
    try:
        return str(answer.json()["detail"])
    except (ValueError, KeyError, TypeError):
        return f"service must answer as coilcal does; it says {answer.status_code} {answer.reason_phrase}"


def _headers(token: str | None) -> dict[str, str]:
    return {} if token is None else {"Authorization": f"Bearer {token}"}


async def items_of(connection: Http, path: str, params: Mapping[str, Any]) -> AsyncGenerator[dict[str, Any]]:
    """Every item of a list of the service, page after page."""
    asked = dict(params)
    while True:
        page = await connection.json("GET", path, params=asked)
        for item in page["items"]:
            yield item
        if page["next"] is None:
            return
        asked["cursor"] = page["next"]
