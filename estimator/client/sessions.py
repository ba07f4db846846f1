"""Sessions at a service that take readings."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from estimator.client.calls import Awaits, Call, Waits
from estimator.client.connection import Http

Reading = Mapping[str, Any]


class SessionCalls:
    """A session at a service that takes readings.

    Args:
        connection: To the service.
        session_id: Id of the session.
    """

    def __init__(self, connection: Http, session_id: str) -> None:
        self.connection, self.id = connection, session_id

    @Call
    async def append(self, readings: Sequence[Reading]) -> int:
        """Send readings, numbered by `sequence`; the number of those that the service has on disk then."""
        content = b"".join(json.dumps(dict(reading)).encode() + b"\n" for reading in readings)
        headers = {"Content-Type": "application/x-ndjson"}
        path = f"/v1/sessions/{self.id}/readings"
        told = await self.connection.json("POST", path, content=content, headers=headers)
        return int(told["n_readings"])

    @Call
    async def info(self) -> dict[str, Any]:
        """The session as the service has it: `state`, `n_readings`, `hash` and more."""
        return await self.connection.json("GET", f"/v1/sessions/{self.id}")

    @Call
    async def close(self) -> dict[str, Any]:
        """End the session, so that it can be calibrated; what `info` then says."""
        return await self.connection.json("POST", f"/v1/sessions/{self.id}/close")


class RemoteSession(SessionCalls, Waits):
    """A session at a service that takes readings."""


class AsyncRemoteSession(SessionCalls, Awaits):
    """A session at a service that takes readings, for `await`; arguments and methods as of `RemoteSession`."""
