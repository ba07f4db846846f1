"""The client that awaits each answer, so that other tasks go on meanwhile."""

from __future__ import annotations

import uuid
from collections.abc import AsyncIterator, Sequence
from types import TracebackType
from typing import Any

import httpx

from estimator.client import jobs, uploads
from estimator.client.calibrations import AsyncRemoteCalibration, summary_of
from estimator.client.client import ATTEMPTS
from estimator.client.connection import AsyncConnection
from estimator.client.diagnoses import RemoteDiagnosis
from estimator.client.following import Tell
from estimator.client.lists import page_after
from estimator.client.registry import AsyncRemoteRegistry
from estimator.client.sessions import AsyncRemoteSession
from estimator.client.steps import send
from estimator.inference.ensemble import SamplerSettings
from estimator.recalibration.registry import Entry
from estimator.rig.rig import Rig
from estimator.store.session import Session


class AsyncClient:
    """A connection to a service, used with `async with`; methods, parameters and errors are those of `Client`.

    Whoever cancels a call that waits for a job does not cancel the job.

    Args:
        url, token, attempts: As of `Client`.
        transport: Another asynchronous transport of httpx, such as one that calls an application in this process.
    """

    def __init__(
        self,
        url: str,
        token: str | None = None,
        transport: httpx.AsyncBaseTransport | None = None,
        attempts: int = ATTEMPTS,
    ) -> None:
        self._connection = AsyncConnection(url, token, transport, attempts)

    async def __aenter__(self) -> AsyncClient:
        return self

    async def __aexit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, traceback: TracebackType | None
    ) -> None:
        await self.close()

    async def close(self) -> None:
        """Close the connections."""
        await self._connection.close()

    async def calibrate(
        self,
        session: Session,
        rig: Rig | None = None,
        *,
        seed: int = 0,
        settings: SamplerSettings | None = None,
        has_integer_counts: bool = True,
        as_described: bool = False,
        on_progress: Tell | None = None,
    ) -> AsyncRemoteCalibration:
        """Calibrate a rig from a session, as `Client.calibrate` does."""
        options = {"seed": seed, "has_integer_counts": has_integer_counts, "as_described": as_described}
        made = jobs.calibrate(session, rig, options, settings, on_progress)
        return AsyncRemoteCalibration(*await self._connection.run(made), self._connection)

    async def diagnose(
        self,
        session: Session,
        rig: Rig | None = None,
        *,
        seed: int = 0,
        has_posterior: bool = False,
        has_corrections: bool = True,
        minutes: float | None = None,
        most_causes: int | None = None,
        most_readings: int | None = None,
        on_progress: Tell | None = None,
    ) -> RemoteDiagnosis[AsyncRemoteCalibration]:
        """Find what the simulation gets wrong, as `Client.diagnose` does."""
        options: dict[str, Any] = {"seed": seed, "has_posterior": has_posterior, "minutes": minutes}
        options |= {"has_corrections": has_corrections}
        options |= {"most_causes": most_causes, "most_readings": most_readings}
        told, rig_text, made = await self._connection.run(jobs.diagnose(session, rig, options, on_progress))
        posterior = None if made is None else AsyncRemoteCalibration(*made, self._connection)
        return RemoteDiagnosis(told, rig_text, posterior)

    async def recalibrate(
        self,
        session: Session,
        rig: Rig | None = None,
        *,
        seed: int = 0,
        settings: SamplerSettings | None = None,
        on_progress: Tell | None = None,
    ) -> Entry:
        """Judge a session against the current version of its rig's registry, as `Client.recalibrate` does."""
        return await self._connection.run(jobs.recalibrate(session, rig, seed, settings, on_progress))

    async def design(
        self, session: Session, rig: Rig | None = None, *, on_progress: Tell | None = None, **aim: Any
    ) -> dict[str, Any]:
        """Propose the next readings, as `Client.design` does."""
        return await self._connection.run(jobs.design(session, rig, aim, on_progress))

    async def batch(
        self,
        sessions: Sequence[Session],
        rig: Rig | None = None,
        *,
        hypotheses: Sequence[str] = ("plain",),
        is_each_coil: bool = False,
        has_posterior: bool = True,
        as_described: bool = False,
        seed: int = 0,
        settings: SamplerSettings | None = None,
        on_progress: Tell | None = None,
    ) -> dict[str, Any]:
        """Calibrate many sessions under several hypotheses, as `Client.batch` does."""
        options: dict[str, Any] = {"hypotheses": list(hypotheses), "is_each_coil": is_each_coil}
        options |= {"has_posterior": has_posterior, "as_described": as_described, "seed": seed}
        return await self._connection.run(jobs.batch(sessions, rig, options, settings, on_progress))

    async def registry(self, rig: Rig) -> AsyncRemoteRegistry:
        """The registry that versions of a rig share by its name."""
        return AsyncRemoteRegistry(self._connection, await self.upload_rig(rig))

    async def calibration(self, calibration_id: str) -> AsyncRemoteCalibration:
        """A calibration that the service has."""
        return AsyncRemoteCalibration(
            *await self._connection.run(summary_of(calibration_id)), self._connection
        )

    async def upload_rig(self, rig: Rig) -> str:
        """Give the service a rig; the id of its version, the same for the same rig."""
        return await self._connection.run(uploads.upload_rig(rig))

    async def upload(self, session: Session) -> str:
        """Give the service a session; its id.

        Where the service has the same readings of the same rig already, nothing is sent: the id is that session's, and so are the
        source and truth in what follows from it.
        """
        return await self._connection.run(uploads.upload(session))

    async def begin(self, rig: Rig, source: str, key: str | None = None) -> AsyncRemoteSession:
        """Begin a session that takes readings; the same key again gives the same session."""
        return self.session(await self._connection.run(uploads.begin(rig, source, key or uuid.uuid4().hex)))

    def session(self, session_id: str) -> AsyncRemoteSession:
        """A session that the service has."""
        return AsyncRemoteSession(self._connection, session_id)

    async def pages(self, path: str, **params: Any) -> AsyncIterator[dict[str, Any]]:
        """Every item of a list of the service, page after page."""
        cursor = None
        while True:
            page = await self._connection.run(page_after(path, params, cursor))
            for item in page["items"]:
                yield item
            cursor = page["next"]
            if cursor is None:
                return

    async def request(self, method: str, path: str, **call: Any) -> httpx.Response:
        """The answer to a request, which is made again while the service cannot answer, as `Client.request` does."""
        return await self._connection.run(send(method, path, **call))
