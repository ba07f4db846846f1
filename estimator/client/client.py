"""The clients: `Client` waits for each answer, `AsyncClient` awaits it."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterator
from contextlib import suppress
from typing import Any

import httpx

from estimator.client.calibrations import AsyncRemoteCalibration, RemoteCalibration
from estimator.client.calls import Awaits, Waits
from estimator.client.connection import AsyncConnection, Connection, items_of
from estimator.client.registry import AsyncRemoteRegistry, RemoteRegistry
from estimator.client.service_calls import ServiceCalls
from estimator.client.sessions import AsyncRemoteSession, RemoteSession

ATTEMPTS = 8  # over a minute: a container that restarts takes half of one


class Client(ServiceCalls[RemoteCalibration, RemoteRegistry, RemoteSession], Waits):
    """A connection to a service.

    Requests that the service may not have got are made again: each carries what makes it harmless twice.

    Args:
        url: Address of the service.
        token: Token, where the service needs one.
        transport: Another transport of httpx, such as one that calls an application in this process.
        attempts: How often a request is made while the service does not answer.
    """

    _calibration, _registry, _session = RemoteCalibration, RemoteRegistry, RemoteSession

    def __init__(
        self,
        url: str,
        token: str | None = None,
        transport: httpx.BaseTransport | None = None,
        attempts: int = ATTEMPTS,
    ) -> None:
        self.connection: Connection = Connection(url, token, transport, attempts)

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections."""
        self.connection.close()

    def pages(self, path: str, **params: Any) -> Iterator[dict[str, Any]]:
        """Every item of a list of the service, page after page."""
        items = items_of(self.connection, path, params)
        with suppress(StopAsyncIteration):
            while True:
                yield self.connection.run(anext(items))


class AsyncClient(ServiceCalls[AsyncRemoteCalibration, AsyncRemoteRegistry, AsyncRemoteSession], Awaits):
    """A connection to a service, used with `async with`; methods, parameters and errors are those of `Client`.

    Cancelling a call that waits for a job does not cancel the job.

    Args:
        url, token, attempts: As of `Client`.
        transport: Another asynchronous transport of httpx, such as one that calls an application in this process.
    """

    _calibration, _registry, _session = AsyncRemoteCalibration, AsyncRemoteRegistry, AsyncRemoteSession

    def __init__(
        self,
        url: str,
        token: str | None = None,
        transport: httpx.AsyncBaseTransport | None = None,
        attempts: int = ATTEMPTS,
    ) -> None:
        self.connection: AsyncConnection = AsyncConnection(url, token, transport, attempts)

    async def __aenter__(self) -> AsyncClient:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def close(self) -> None:
        """Close the connections."""
        await self.connection.close()

    def pages(self, path: str, **params: Any) -> AsyncIterator[dict[str, Any]]:
        """Every item of a list of the service, page after page."""
        return items_of(self.connection, path, params)
