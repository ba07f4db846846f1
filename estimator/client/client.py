"""The client that waits for each answer."""

from __future__ import annotations

import uuid
from collections.abc import Iterator, Sequence
from types import TracebackType
from typing import Any

import httpx

from estimator.client import jobs, uploads
from estimator.client.calibrations import RemoteCalibration, summary_of
from estimator.client.connection import Connection
from estimator.client.diagnoses import RemoteDiagnosis
from estimator.client.following import Tell
from estimator.client.lists import page_after
from estimator.client.registry import RemoteRegistry
from estimator.client.sessions import RemoteSession
from estimator.client.steps import send
from estimator.inference.ensemble import SamplerSettings
from estimator.recalibration.registry import Entry
from estimator.rig.rig import Rig
from estimator.store.session import Session

ATTEMPTS = 8  # over a minute: a container that restarts takes half of one


class Client:
    """A connection to a service.

    Requests that the service may not have got are made again: each carries what makes it harmless twice.

    Args:
        url: Address of the service.
        token: Token, where the service needs one.
        transport: Another transport of httpx, such as one that calls an application in this process.
        attempts: How often a request is made while the service does not answer.
    """

    def __init__(
        self,
        url: str,
        token: str | None = None,
        transport: httpx.BaseTransport | None = None,
        attempts: int = ATTEMPTS,
    ) -> None:
        self._connection = Connection(url, token, transport, attempts)

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections."""
        self._connection.close()

    def calibrate(
        self,
        session: Session,
        rig: Rig | None = None,
        *,
        seed: int = 0,
        settings: SamplerSettings | None = None,
        has_integer_counts: bool = True,
        as_described: bool = False,
        on_progress: Tell | None = None,
    ) -> RemoteCalibration:
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
        options = {"seed": seed, "has_integer_counts": has_integer_counts, "as_described": as_described}
        made = jobs.calibrate(session, rig, options, settings, on_progress)
        return RemoteCalibration(*self._connection.run(made), self._connection)

    def diagnose(
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
    ) -> RemoteDiagnosis[RemoteCalibration]:
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
        told, rig_text, made = self._connection.run(jobs.diagnose(session, rig, options, on_progress))
        posterior = None if made is None else RemoteCalibration(*made, self._connection)
        return RemoteDiagnosis(told, rig_text, posterior)

    def recalibrate(
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
        return self._connection.run(jobs.recalibrate(session, rig, seed, settings, on_progress))

    def design(
        self, session: Session, rig: Rig | None = None, *, on_progress: Tell | None = None, **aim: Any
    ) -> dict[str, Any]:
        """Propose the next readings, as `estimator.design` does.

        Args:
            session, rig, on_progress: As in `calibrate`.
            aim: `split`, `shrink` or `correction`, and `degree` and `n_readings` where wanted, as in `estimator.design`.
        Returns: What `coilcal design --json` prints; `plan` is the text of the plan.
        Raises:
            InvalidInput, JobFailed, ServiceFault: As in `calibrate`.
        """
        return self._connection.run(jobs.design(session, rig, aim, on_progress))

    def batch(
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
        options: dict[str, Any] = {"hypotheses": list(hypotheses), "is_each_coil": is_each_coil}
        options |= {"has_posterior": has_posterior, "as_described": as_described, "seed": seed}
        return self._connection.run(jobs.batch(sessions, rig, options, settings, on_progress))

    def registry(self, rig: Rig) -> RemoteRegistry:
        """The registry that versions of a rig share by its name."""
        return RemoteRegistry(self._connection, self.upload_rig(rig))

    def calibration(self, calibration_id: str) -> RemoteCalibration:
        """A calibration that the service has."""
        return RemoteCalibration(*self._connection.run(summary_of(calibration_id)), self._connection)

    def upload_rig(self, rig: Rig) -> str:
        """Give the service a rig; the id of its version, the same for the same rig."""
        return self._connection.run(uploads.upload_rig(rig))

    def upload(self, session: Session) -> str:
        """Give the service a session; its id.

        Where the service has the same readings of the same rig already, nothing is sent: the id is that session's, and so are the
        source and truth in what follows from it.
        """
        return self._connection.run(uploads.upload(session))

    def begin(self, rig: Rig, source: str, key: str | None = None) -> RemoteSession:
        """Begin a session that takes readings.

        Args:
            rig: The rig that is measured.
            source: Origin of the readings, in words.
            key: The same key again gives the same session.
        """
        return self.session(self._connection.run(uploads.begin(rig, source, key or uuid.uuid4().hex)))

    def session(self, session_id: str) -> RemoteSession:
        """A session that the service has."""
        return RemoteSession(self._connection, session_id)

    def pages(self, path: str, **params: Any) -> Iterator[dict[str, Any]]:
        """Every item of a list of the service, page after page."""
        cursor = None
        while True:
            page = self._connection.run(page_after(path, params, cursor))
            yield from page["items"]
            cursor = page["next"]
            if cursor is None:
                return

    def request(self, method: str, path: str, **call: Any) -> httpx.Response:
        """The answer to a request, which is made again while the service cannot answer.

        Args:
            method, path: What is asked for.
            call: Further arguments of `httpx.Client.request`.
        Raises:
            InvalidInput: The service refuses it; the message is its sentence.
            ServiceFault: It cannot be reached, or fails.
        """
        return self._connection.run(send(method, path, **call))
