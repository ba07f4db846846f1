"""Sessions at a service that take readings."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from estimator.client.connection import AsyncConnection, Connection
from estimator.client.steps import Steps, send_json

Reading = Mapping[str, Any]


class RemoteSession:
    """A session at a service that takes readings.

    Args:
        connection: To the service.
        session_id: Id of the session.
    """

    def __init__(self, connection: Connection, session_id: str) -> None:
        self._connection, self.id = connection, session_id

    def append(self, readings: Sequence[Reading]) -> int:
        """Send readings, numbered by `sequence`; the number of those that the service has on disk then."""
        return self._connection.run(_append(self.id, readings))

    def info(self) -> dict[str, Any]:
        """The session as the service has it: `state`, `n_readings`, `hash` and more."""
        return self._connection.run(send_json("GET", f"/v1/sessions/{self.id}"))

    def close(self) -> dict[str, Any]:
        """End the session, so that it can be calibrated; what `info` then says."""
        return self._connection.run(send_json("POST", f"/v1/sessions/{self.id}/close"))


class AsyncRemoteSession:
    """A session at a service that takes readings, for `await`; arguments and methods as of `RemoteSession`."""

    def __init__(self, connection: AsyncConnection, session_id: str) -> None:
        self._connection, self.id = connection, session_id

    async def append(self, readings: Sequence[Reading]) -> int:
        """Send readings; the number of those that the service has on disk then."""
        return await self._connection.run(_append(self.id, readings))

    async def info(self) -> dict[str, Any]:
        """The session as the service has it."""
        return await self._connection.run(send_json("GET", f"/v1/sessions/{self.id}"))

    async def close(self) -> dict[str, Any]:
        """End the session."""
        return await self._connection.run(send_json("POST", f"/v1/sessions/{self.id}/close"))


def _append(session_id: str, readings: Sequence[Reading]) -> Steps[int]:
    content = b"".join(json.dumps(dict(reading)).encode() + b"\n" for reading in readings)
    headers = {"Content-Type": "application/x-ndjson"}
    told = yield from send_json(
        "POST", f"/v1/sessions/{session_id}/readings", content=content, headers=headers
    )
    return int(told["n_readings"])
