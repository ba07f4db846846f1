"""What a service can be asked, written once for the client that waits and the one that awaits."""

from __future__ import annotations

import uuid
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any, ClassVar, Generic, TypeVar

import httpx

from estimator.client.calibrations import C, calibration_of
from estimator.client.calls import Call
from estimator.client.connection import Http
from estimator.client.diagnoses import RemoteDiagnosis
from estimator.client.following import Tell, result_of
from estimator.client.registry import AsyncRemoteRegistry, RemoteRegistry
from estimator.client.sessions import AsyncRemoteSession, RemoteSession, upload, upload_rig
from estimator.inference.ensemble import SamplerSettings
from estimator.recalibration.log import Entry
from estimator.rig.rig import Rig
from estimator.store.session import Session

R = TypeVar("R", RemoteRegistry, AsyncRemoteRegistry)
S = TypeVar("S", RemoteSession, AsyncRemoteSession)


class ServiceCalls(Generic[C, R, S]):
    """What a service can be asked, whether the caller waits or awaits."""

    _calibration: ClassVar[type[Any]]
    _registry: ClassVar[type[Any]]
    _session: ClassVar[type[Any]]
    connection: Http

    @Call
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
    ) -> C:
        """Calibrate a rig from a session, as `estimator.calibrate` does.

        Args:
            session, rig, seed, settings, has_integer_counts, as_described: As in `estimator.calibrate`.
            on_progress: Called as the work proceeds, with `words` and numbers.
        Returns: The calibrated model, which stays at the service.
        Raises:
            InvalidInput: The service refuses the session, the rig or the settings.
            JobFailed: The readings cannot support a fit, or the job was cancelled.
            ServiceFault: The service cannot be reached.
        """
        options = {"seed": seed, "settings": _sampling(settings)}
        options |= {"has_integer_counts": has_integer_counts, "as_described": as_described}
        result = await self._of_session("calibrate", session, rig, options, on_progress)
        return self._calibration(str(result["calibration_id"]), result["result"], self.connection)

    @Call
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
    ) -> RemoteDiagnosis[C]:
        """Find what the simulation gets wrong, as `estimator.diagnose` does.

        Args:
            session, rig, seed, has_posterior, has_corrections, most_readings: As in `estimator.diagnose`.
            minutes, most_causes: Its limits.
            on_progress: Called as the work proceeds, with `words` and numbers.
        Raises:
            InvalidInput, JobFailed, ServiceFault: As in `calibrate`.
        """
        options: dict[str, Any] = {"seed": seed, "has_posterior": has_posterior, "minutes": minutes}
        options |= {"has_corrections": has_corrections}
        options |= {"most_causes": most_causes, "most_readings": most_readings}
        result = await self._of_session("diagnose", session, rig, options, on_progress)
        made = result["calibration_id"]
        posterior = (
            None if made is None else await calibration_of(self._calibration, self.connection, str(made))
        )
        return RemoteDiagnosis(result["result"], result["extended_rig"], posterior)

    @Call
    async def recalibrate(
        self,
        session: Session,
        rig: Rig | None = None,
        *,
        seed: int = 0,
        settings: SamplerSettings | None = None,
        on_progress: Tell | None = None,
    ) -> Entry:
        """Judge a session against the current version of its rig's registry, as `estimator.recalibrate` does with those of an inbox.

        Args:
            session, rig, seed, settings, on_progress: As in `calibrate`.
        Returns: The entry of the registry's log; `session` is the id of the session. What was judged before is not judged again.
        Raises:
            InvalidInput, JobFailed, ServiceFault: As in `calibrate`.
        """
        options = {"seed": seed, "settings": _sampling(settings)}
        result = await self._of_session("recalibrate", session, rig, options, on_progress)
        return Entry(**result["result"])

    @Call
    async def design(
        self, /, session: Session, rig: Rig | None = None, *, on_progress: Tell | None = None, **aim: Any
    ) -> dict[str, Any]:
        """Propose the next readings, as `estimator.design` does.

        Args:
            session, rig, on_progress: As in `calibrate`.
            aim: `split`, `shrink` or `correction`, and `degree` and `n_readings` where wanted, as in `estimator.design`.
        Returns: What `coilcal design --json` prints; `plan` is the text of the plan.
        Raises:
            InvalidInput, JobFailed, ServiceFault: As in `calibrate`.
        """
        return dict((await self._of_session("design", session, rig, aim, on_progress))["result"])

    @Call
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
        """Calibrate many sessions under several hypotheses, as `estimator.batch` does.

        Args:
            sessions, hypotheses, is_each_coil, has_posterior, as_described: As in `estimator.batch`.
            rig, seed, settings, on_progress: As in `calibrate`.
        Returns: `fits`, a row for each as in `summary.csv`, and `failed`, reasons by session.
        Raises:
            InvalidInput, JobFailed, ServiceFault: As in `calibrate`.
        """
        body: dict[str, Any] = {
            "session_ids": [await upload(self.connection, session) for session in sessions]
        }
        body |= {
            "rig_id": await self._rig_id(rig),
            "hypotheses": list(hypotheses),
            "is_each_coil": is_each_coil,
        }
        body |= {"has_posterior": has_posterior, "as_described": as_described, "seed": seed}
        body |= {"settings": _sampling(settings)}
        return dict((await result_of(self.connection, "batch", body, on_progress))["result"])

    @Call
    async def registry(self, rig: Rig) -> R:
        """The registry that versions of a rig share by its name."""
        return self._registry(self.connection, await upload_rig(self.connection, rig))

    @Call
    async def calibration(self, calibration_id: str) -> C:
        """A calibration that the service has."""
        return await calibration_of(self._calibration, self.connection, calibration_id)

    @Call
    async def upload_rig(self, rig: Rig) -> str:
        """Give the service a rig; the id of its version, the same for the same rig."""
        return await upload_rig(self.connection, rig)

    @Call
    async def upload(self, session: Session) -> str:
        """Give the service a session; its id.

        Where the service has the same readings of the same rig already, nothing is sent: the id is that session's, and so are the
        source and truth in what follows from it.
        """
        return await upload(self.connection, session)

    @Call
    async def begin(self, rig: Rig, source: str, key: str | None = None) -> S:
        """Begin a session that takes readings.

        Args:
            rig: The rig that is measured.
            source: Origin of the readings, in words.
            key: The same key again gives the same session.
        """
        body = {"rig_id": await upload_rig(self.connection, rig), "source": source}
        headers = {"Idempotency-Key": key or uuid.uuid4().hex}
        info = await self.connection.json("POST", "/v1/sessions", json=body, headers=headers)
        return self.session(str(info["id"]))

    def session(self, session_id: str) -> S:
        """A session that the service has."""
        return self._session(self.connection, session_id)

    @Call
    async def request(self, /, method: str, path: str, **call: Any) -> httpx.Response:
        """The answer to a request, which is made again while the service cannot answer.

        Args:
            method, path: What is asked for.
            call: Further arguments of `httpx.Client.request`.
        Raises:
            InvalidInput: The service refuses it; the message is its sentence.
            ServiceFault: It cannot be reached, or fails.
        """
        return await self.connection.send(method, path, **call)

    async def _of_session(
        self, kind: str, session: Session, rig: Rig | None, options: Mapping[str, Any], tell: Tell | None
    ) -> dict[str, Any]:
        """The result of a job with one session."""
        rig_id = await self._rig_id(rig)
        body = {"session_id": await upload(self.connection, session), "rig_id": rig_id, **options}
        return await result_of(self.connection, kind, body, tell)

    async def _rig_id(self, rig: Rig | None) -> str | None:
        return None if rig is None else await upload_rig(self.connection, rig)


def _sampling(settings: SamplerSettings | None) -> dict[str, Any]:
    """Settings as the service takes them: the seed stands beside."""
    wanted = asdict(settings or SamplerSettings())
    wanted.pop("seed")
    return wanted
