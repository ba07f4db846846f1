"""A job of the service from its beginning to its result."""

from __future__ import annotations

import uuid
from collections.abc import Callable, Mapping
from typing import Any

from estimator.client.connection import Http, JobFailed
from estimator.json_files import json_of

Tell = Callable[[Mapping[str, Any]], None]
LOOK_EVERY_S = 1.0


async def result_of(
    connection: Http, kind: str, body: Mapping[str, Any], tell: Tell | None
) -> dict[str, Any]:
    """The result of a job that is made, followed and waited for, also while the service restarts.

    Args:
        connection: To the service.
        kind: Kind of the job, as in the path of the API.
        body: What is asked for.
        tell: Called as the work proceeds.
    Raises:
        JobFailed: It ended without a result.
    """
    key = {"Idempotency-Key": uuid.uuid4().hex}  # a request that is made again gives the same job
    job = await connection.json("POST", f"/v1/jobs/{kind}", json=body, headers=key)
    path = f"/v1/jobs/{job['id']}"
    events = _Events(tell)
    while True:
        await events.listen(connection, path)
        if events.have_ended:
            break
        await connection.pause(LOOK_EVERY_S)  # the service was ended or killed
    job = await connection.json("GET", path)
    if job["state"] != "done":
        raise JobFailed(job["fault"] or f"job must be done; it was {job['state']} (job {job['id']})")
    return await connection.json("GET", f"{path}/result")


class _Events:
    """Server-sent events of a job, told line by line; a stream goes on after the last one that was told.

    Args:
        tell: Called with the content of each.
    """

    def __init__(self, tell: Tell | None) -> None:
        self._tell = tell
        self._event: dict[str, str] = {}
        self._last_id = "0"
        self.have_ended = False

    async def listen(self, connection: Http, path: str) -> None:
        self._event = {}  # an event that a broken connection cut is sent again
        await connection.listen(f"{path}/events", {"Last-Event-ID": self._last_id}, self._take)

    def _take(self, line: str) -> None:
        if line:
            name, _, value = line.partition(":")
            self._event[name] = value.removeprefix(" ")
            return
        event, self._event = self._event, {}
        if event.get("event") == "end":
            self.have_ended = True
        elif "data" in event:
            self._last_id = event.get("id", self._last_id)
            if self._tell is not None:
                self._tell(json_of(event["data"], "an event of the service"))
