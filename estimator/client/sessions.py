"""Sessions at a service that take readings, and whole sessions with their rigs; what it has already is not sent again."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from estimator.client.calls import Awaits, Call, Waits
from estimator.client.connection import Http
from estimator.rig.rig import Rig
from estimator.rig_files.write import rig_text
from estimator.store.session import Session
from estimator.store.zipped import zipped

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
    async def label(self, labels: Mapping[str, Any]) -> dict[str, Any]:
        """Give the session labels by which it is found again; what `info` then says.

        Args:
            labels: `name`, `note`, `tags` (a list of words) and `measured` (an ISO date); what is left out stays.
        """
        return await self.connection.json("PATCH", f"/v1/sessions/{self.id}", json=dict(labels))

    @Call
    async def next(
        self, goals: Sequence[str], places: str, *, most_stops: int = 200, seed: int = 0
    ) -> dict[str, Any]:
        """What to measure next: `current_A`, `motion`, `is_validation` and `reason`, or `is_end`.

        Args:
            goals: What shall be known, as in `coilcal plan --goal`.
            places: Text of a plan file with the poses and currents to choose from.
            most_stops: Number of stops after which to end in any case.
            seed: Of all random choices; the same readings and seed give the same stop.
        """
        body = {"goals": list(goals), "places": places, "most_stops": most_stops, "seed": seed}
        return await self.connection.json("POST", f"/v1/sessions/{self.id}/next", json=body)

    @Call
    async def close(self) -> dict[str, Any]:
        """End the session, so that it can be calibrated; what `info` then says."""
        return await self.connection.json("POST", f"/v1/sessions/{self.id}/close")


class RemoteSession(SessionCalls, Waits):
    """A session at a service that takes readings."""


class AsyncRemoteSession(SessionCalls, Awaits):
    """A session at a service that takes readings, for `await`; arguments and methods as of `RemoteSession`."""


async def upload_rig(connection: Http, rig: Rig) -> str:
    """The id of a rig's version, the same for the same rig."""
    headers = {"Content-Type": "application/yaml"}
    known = await connection.json("POST", "/v1/rigs", content=rig_text(rig).encode(), headers=headers)
    return str(known["id"])


async def upload(connection: Http, session: Session) -> str:
    """The id of a session."""
    params = {"hash": session.hash, "limit": 1}
    known = (await connection.json("GET", "/v1/sessions", params=params))["items"]
    if known:
        return str(known[0]["id"])
    rig_id = await upload_rig(connection, session.rig)
    info = await connection.json(
        "POST",
        "/v1/sessions/import-zip",
        params={"rig_id": rig_id},
        headers={"Content-Type": "application/zip"},
        content=await connection.work(lambda: _zipped(session)),
    )
    return str(info["id"])


def _zipped(session: Session) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "session.zarr"
        session.save(path)
        return zipped(path)
