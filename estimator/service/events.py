"""Progress of a job as server-sent events, from the file that its worker writes; a reader may go on where it left off."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from fastapi.sse import ServerSentEvent
from starlette.concurrency import run_in_threadpool

from estimator.errors import InvalidInput
from estimator.json_files import json_object
from estimator.service.core import Core
from estimator.service.job_queue import ENDED
from estimator.service.work import PROGRESS

LOOK_EVERY_S = 0.25


async def events_of(
    core: Core, job_id: str, last_event_id: str | None, info: Callable[[], Any]
) -> AsyncIterator[ServerSentEvent]:
    """Events of a job: what its worker has reported so far, what it reports from now on, and its end.

    Args:
        core: The service.
        job_id: The job.
        last_event_id: Id of the last event that the client has; it gets those after it.
        info: The job as the API shows it, now.
    """
    job = await run_in_threadpool(info)
    path = core.jobs.folder(job_id) / PROGRESS
    n_known = (
        int(last_event_id) if last_event_id and last_event_id.isascii() and last_event_id.isdecimal() else 0
    )
    lines = _Lines(path)
    while not core.is_ending:
        has_ended = job.state in ENDED  # asked before the file is read, so that no line is missed
        for number, line in await run_in_threadpool(lines.new):
            if number > n_known:
                yield ServerSentEvent(data=line, event="progress", id=str(number))
        if has_ended:
            yield ServerSentEvent(data=job, event="end")
            return
        await asyncio.sleep(LOOK_EVERY_S)
        job = await run_in_threadpool(info)


class _Lines:
    """Whole lines of a growing file, each with its number."""

    def __init__(self, path: Path) -> None:
        self._path, self._end, self._number = path, 0, 0

    def new(self) -> list[tuple[int, dict[str, Any]]]:
        """Lines since the last call; one that a kill has torn is left out, but counted."""
        try:
            with self._path.open("rb") as file:
                file.seek(self._end)
                *whole, _ = file.read().split(b"\n")
        except FileNotFoundError:
            return []
        entries = []
        for line in whole:
            self._end += len(line) + 1
            self._number += 1
            with suppress(InvalidInput):
                entries.append((self._number, json_object(line, self._path)))
        return entries
