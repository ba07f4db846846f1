"""A client of `coilcal serve` that mirrors the Python API, so that a script moves from local to remote by one line.

    calibration = estimator.calibrate(session)                       # here
    calibration = Client("http://127.0.0.1:8765").calibrate(session)   # there

Needs the extra `coilcal[client]`, or `coilcal[service]`.
"""

from __future__ import annotations

import io
import json
import math
import tempfile
import time
import uuid
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import httpx
import torch
from jaxtyping import Float
from torch import Tensor

from estimator.errors import CoilcalError, InvalidInput
from estimator.inference.ensemble import SamplerSettings
from estimator.recalibration.registry import Entry
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text
from estimator.rig_files.write import rig_text
from estimator.store.session import Session

if TYPE_CHECKING:
    import pyarrow as pa

TIMEOUT_S = 120.0
LOOK_EVERY_S = 1.0
ATTEMPTS = 6  # while the service restarts, or has too much to do
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.5, 30.0
BUSY = (429, 503)

Tell = Callable[[Mapping[str, Any]], None]
Axis = tuple[float, float, int]
AT_ZERO: Axis = (0.0, 0.0, 1)


class ServiceFault(CoilcalError):
    """The service cannot be reached, or failed."""


class JobFailed(CoilcalError):
    """A job ended without a result; the message is the sentence of the service."""


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
        self._attempts = attempts
        headers = {} if token is None else {"Authorization": f"Bearer {token}"}
        self._http = httpx.Client(base_url=url, headers=headers, timeout=TIMEOUT_S, transport=transport)

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections."""
        self._http.close()

    def calibrate(
        self,
        session: Session,
        rig: Rig | None = None,
        *,
        seed: int = 0,
        settings: SamplerSettings | None = None,
        has_integer_counts: bool = True,
        on_progress: Tell | None = None,
    ) -> RemoteCalibration:
        """Calibrate a rig from a session, as `estimator.calibrate` does.

        Args:
            session, rig, seed, settings, has_integer_counts: As in `estimator.calibrate`.
            on_progress: Called as the work proceeds, with `words` and numbers.
        Returns: The calibrated model, which stays at the service.
        Raises:
            InvalidInput: The service refuses the session, the rig or the settings.
            JobFailed: The readings cannot support a fit, or the job was cancelled.
            ServiceFault: The service cannot be reached.
        """
        body = {"seed": seed, "settings": _sampling(settings), "has_integer_counts": has_integer_counts}
        result = self._done("calibrate", session, rig, body, on_progress)
        return RemoteCalibration(self, result["calibration_id"], result["result"])

    def diagnose(
        self,
        session: Session,
        rig: Rig | None = None,
        *,
        seed: int = 0,
        has_posterior: bool = False,
        minutes: float | None = None,
        most_causes: int | None = None,
        most_readings: int | None = None,
        on_progress: Tell | None = None,
    ) -> RemoteDiagnosis:
        """Find what the simulation gets wrong, as `estimator.diagnose` does.

        Args:
            session, rig, seed, has_posterior, most_readings: As in `estimator.diagnose`.
            minutes, most_causes: Its limits.
            on_progress: Called as the work proceeds, with `words` and numbers.
        Raises:
            InvalidInput, JobFailed, ServiceFault: As in `calibrate`.
        """
        body: dict[str, Any] = {"seed": seed, "has_posterior": has_posterior, "minutes": minutes}
        body |= {"most_causes": most_causes, "most_readings": most_readings}
        result = self._done("diagnose", session, rig, body, on_progress)
        posterior = None
        if result["calibration_id"] is not None:
            summary = self.request("GET", f"/v1/calibrations/{result['calibration_id']}/summary").json()
            posterior = RemoteCalibration(self, result["calibration_id"], summary)
        return RemoteDiagnosis(result["result"], result["extended_rig"], posterior)

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
        body = {"seed": seed, "settings": _sampling(settings)}
        return Entry(**self._done("recalibrate", session, rig, body, on_progress)["result"])

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
        return dict(self._done("design", session, rig, aim, on_progress)["result"])

    def batch(
        self,
        sessions: Sequence[Session],
        rig: Rig | None = None,
        *,
        hypotheses: Sequence[str] = ("plain",),
        is_each_coil: bool = False,
        has_posterior: bool = True,
        seed: int = 0,
        settings: SamplerSettings | None = None,
        on_progress: Tell | None = None,
    ) -> dict[str, Any]:
        """Calibrate many sessions under several hypotheses, as `estimator.batch` does.

        Args:
            sessions, hypotheses, is_each_coil, has_posterior: As in `estimator.batch`.
            rig, seed, settings, on_progress: As in `calibrate`.
        Returns: `fits`, a row for each as in `summary.csv`, and `failed`, reasons by session.
        Raises:
            InvalidInput, JobFailed, ServiceFault: As in `calibrate`.
        """
        body = {
            "session_ids": [self.upload(session) for session in sessions],
            "rig_id": None if rig is None else self.upload_rig(rig),
            "hypotheses": list(hypotheses),
            "is_each_coil": is_each_coil,
            "has_posterior": has_posterior,
            "seed": seed,
            "settings": _sampling(settings),
        }
        return dict(self._job("batch", body, on_progress)["result"])

    def registry(self, rig: Rig) -> RemoteRegistry:
        """The registry that versions of a rig share by its name."""
        return RemoteRegistry(self, self.upload_rig(rig))

    def calibration(self, calibration_id: str) -> RemoteCalibration:
        """A calibration that the service has."""
        summary = self.request("GET", f"/v1/calibrations/{calibration_id}/summary").json()
        return RemoteCalibration(self, calibration_id, summary)

    def upload_rig(self, rig: Rig) -> str:
        """Give the service a rig; the id of its version, the same for the same rig."""
        headers = {"Content-Type": "application/yaml"}
        return str(
            self.request("POST", "/v1/rigs", content=rig_text(rig).encode(), headers=headers).json()["id"]
        )

    def upload(self, session: Session) -> str:
        """Give the service a session; its id. One that it has already is not sent again."""
        known = self.request("GET", "/v1/sessions", params={"hash": session.hash, "limit": 1}).json()["items"]
        if known:
            return str(known[0]["id"])
        rig_id = self.upload_rig(session.rig)
        headers = {"Content-Type": "application/zip"}
        call = {"params": {"rig_id": rig_id}, "headers": headers, "content": _zipped(session)}
        return str(self.request("POST", "/v1/sessions/import-zip", **call).json()["id"])

    def begin(self, rig: Rig, source: str, key: str | None = None) -> RemoteSession:
        """Begin a session that takes readings.

        Args:
            rig: The rig that is measured.
            source: Origin of the readings, in words.
            key: The same key again gives the same session.
        """
        call: dict[str, Any] = {"json": {"rig_id": self.upload_rig(rig), "source": source}}
        call["headers"] = {"Idempotency-Key": key or uuid.uuid4().hex}
        return RemoteSession(self, str(self.request("POST", "/v1/sessions", **call).json()["id"]))

    def pages(self, path: str, **params: Any) -> Iterator[dict[str, Any]]:
        """Every item of a list of the service, page after page."""
        page = self.request("GET", path, params=params).json()
        yield from page["items"]
        while page["next"] is not None:
            page = self.request("GET", path, params={**params, "cursor": page["next"]}).json()
            yield from page["items"]

    def request(self, method: str, path: str, **call: Any) -> httpx.Response:
        """The answer to a request, which is made again while the service cannot answer.

        Raises:
            InvalidInput: The service refuses it; the message is its sentence.
            ServiceFault: It cannot be reached, or fails.
        """
        fault = ""
        for pause_s in (*_pauses(self._attempts - 1), None):
            try:
                answer = self._http.request(method, path, **call)
            except httpx.TransportError as error:
                fault = f"service must answer; {self._http.base_url} does not: {error}"
            else:
                if answer.is_success:
                    return answer
                fault = _sentence(answer)
                if answer.status_code not in BUSY:
                    raise (ServiceFault if answer.is_server_error else InvalidInput)(fault)
                after = answer.headers.get("retry-after", "")
                if pause_s is not None and after.isdecimal():
                    pause_s = min(float(after), LONGEST_PAUSE_S)  # noqa: PLW2901  the service knows better
            if pause_s is not None:
                time.sleep(pause_s)
        raise ServiceFault(fault)

    def _done(
        self, kind: str, session: Session, rig: Rig | None, options: Mapping[str, Any], tell: Tell | None
    ) -> dict[str, Any]:
        """The result of a job for one session."""
        rig_id = None if rig is None else self.upload_rig(rig)
        return self._job(kind, {"session_id": self.upload(session), "rig_id": rig_id, **options}, tell)

    def _job(self, kind: str, body: Mapping[str, Any], tell: Tell | None) -> dict[str, Any]:
        """The result of a job that is made, followed and waited for."""
        key = {"Idempotency-Key": uuid.uuid4().hex}  # a request that is made again gives the same job
        job = self.request("POST", f"/v1/jobs/{kind}", json=body, headers=key).json()
        for words in self._events(job["id"]):
            if tell is not None:
                tell(words)
        job = self.request("GET", f"/v1/jobs/{job['id']}").json()
        if job["state"] != "done":
            raise JobFailed(job["fault"] or f"job must be done; it was {job['state']} (job {job['id']})")
        return dict(self.request("GET", f"/v1/jobs/{job['id']}/result").json())

    def _events(self, job_id: str) -> Iterator[dict[str, Any]]:
        """Progress of a job until it has ended, also while the service restarts."""
        last_id = "0"
        pauses = iter(_pauses(ATTEMPTS))
        while True:
            try:
                headers = {"Last-Event-ID": last_id}
                with self._http.stream("GET", f"/v1/jobs/{job_id}/events", headers=headers) as answer:
                    if answer.status_code in BUSY:
                        raise httpx.ReadError("busy")
                    if not answer.is_success:
                        answer.read()
                        raise InvalidInput(_sentence(answer))
                    for event in _parsed(answer.iter_lines()):
                        pauses = iter(_pauses(ATTEMPTS))
                        if event.get("event") == "end":
                            return
                        last_id = event.get("id", last_id)
                        yield json.loads(event["data"])
            except httpx.TransportError as error:
                pause_s = next(pauses, None)
                if pause_s is None:
                    raise ServiceFault(
                        f"service must answer; {self._http.base_url} does not: {error}"
                    ) from error
                time.sleep(pause_s)
            else:
                time.sleep(LOOK_EVERY_S)  # it ended the stream, because it stops


@dataclass(frozen=True)
class RemoteCalibration:
    """A calibrated model at a service, read as `estimator.Calibration` is."""

    client: Client = field(repr=False)
    id: str
    summary_json: Mapping[str, Any] = field(repr=False)

    def summary(self) -> Mapping[str, Any]:
        """The content of `summary.json`."""
        return self.summary_json

    @property
    def best(self) -> Mapping[str, float]:
        """Every number of the rig at the maximum of the posterior."""
        return dict(self.summary_json["best"])

    @property
    def rig(self) -> Rig:
        """The rig with its priors."""
        text = self.client.request("GET", f"/v1/calibrations/{self.id}/rig").text
        return rig_from_text(text, f"rig of calibration {self.id}")

    def field(
        self,
        points_m: Float[Tensor, "point 3"],
        currents_A: Mapping[str, float],
        motion: Mapping[str, Float[Tensor, " 6"]] | None = None,
    ) -> Float[Tensor, "point 3"]:
        """Flux density in the world frame, in tesla; as `estimator.Calibration.field`."""
        return self._predicted(points_m, currents_A, motion, has_intervals=False)["field_T"]

    def gradient(
        self,
        points_m: Float[Tensor, "point 3"],
        currents_A: Mapping[str, float],
        motion: Mapping[str, Float[Tensor, " 6"]] | None = None,
    ) -> Float[Tensor, "point 3 3"]:
        """dB_i / dx_j in the world frame, in T/m; as `estimator.Calibration.gradient`."""
        asked = {"has_field": False, "has_gradient": True, "has_intervals": False}
        return self._predicted(points_m, currents_A, motion, **asked)["gradient_T_per_m"]

    def field_interval(
        self,
        points_m: Float[Tensor, "point 3"],
        currents_A: Mapping[str, float],
        level: float = 0.9,
        motion: Mapping[str, Float[Tensor, " 6"]] | None = None,
    ) -> tuple[Float[Tensor, "point 3"], Float[Tensor, "point 3"]]:
        """Credible interval of each field component; as `estimator.Calibration.field_interval`."""
        found = self._predicted(points_m, currents_A, motion, level=level)
        return found["field_lower_T"], found["field_upper_T"]

    def gradient_interval(
        self,
        points_m: Float[Tensor, "point 3"],
        currents_A: Mapping[str, float],
        level: float = 0.9,
        motion: Mapping[str, Float[Tensor, " 6"]] | None = None,
    ) -> tuple[Float[Tensor, "point 3 3"], Float[Tensor, "point 3 3"]]:
        """Credible interval of each dB_i / dx_j; as `estimator.Calibration.gradient_interval`."""
        asked = {"has_field": False, "has_gradient": True, "level": level}
        found = self._predicted(points_m, currents_A, motion, **asked)
        return found["gradient_lower_T_per_m"], found["gradient_upper_T_per_m"]

    def grid(
        self,
        currents_A: Mapping[str, float],
        level: float = 0.9,
        motion: Mapping[str, Float[Tensor, " 6"]] | None = None,
        *,
        x: Axis = AT_ZERO,
        y: Axis = AT_ZERO,
        z: Axis = AT_ZERO,
        has_gradient: bool = False,
    ) -> pa.Table:
        """Field, and gradient if wanted, with credible intervals on a regular grid of the world frame.

        Args:
            currents_A, level, motion: As in `field_interval`.
            x, y, z: First and last coordinate in metres, and how many there are.
            has_gradient: With dB_i / dx_j.
        Returns: An Arrow table with a row for each point, z changing fastest: `x_m`, `Bx_T`, `Bx_lower_T`, and so on; null inside a
            winding. Its `to_pandas()` is a data frame.
        Raises:
            ModuleNotFoundError: pyarrow is missing; `pip install pyarrow`.
        """
        import pyarrow as pa  # only here, for it is larger than all else that a client needs

        axes = {
            name: {"first_m": first_m, "last_m": last_m, "n": n}
            for name, (first_m, last_m, n) in {"x": x, "y": y, "z": z}.items()
        }
        body = {**axes, **_wish(currents_A, motion), "level": level, "has_gradient": has_gradient}
        answer = self.client.request("POST", f"/v1/calibrations/{self.id}/grid.arrow", json=body)
        return pa.ipc.open_stream(answer.content).read_all()

    def _predicted(
        self,
        points_m: Tensor,
        currents_A: Mapping[str, float],
        motion: Mapping[str, Tensor] | None,
        **asked: Any,
    ) -> dict[str, Tensor]:
        """What was asked for, as tensors; NaN inside a winding."""
        body = {"points_m": points_m.tolist(), **_wish(currents_A, motion), **asked}
        answer = self.client.request("POST", f"/v1/calibrations/{self.id}/predict", json=body).json()
        return {name: torch.tensor(_nans(values), dtype=torch.float64) for name, values in answer.items()}


@dataclass(frozen=True)
class RemoteDiagnosis:
    """The result of a diagnosis, read as `estimator.Diagnosis` is.

    Attributes:
        diagnosis_json: Content of `diagnosis.json`.
        extended_rig_text: Text of `rig_extended.yaml`.
        posterior: The extended rig, sampled; None where that was not asked for or nothing was found.
    """

    diagnosis_json: Mapping[str, Any]
    extended_rig_text: str = field(repr=False)
    posterior: RemoteCalibration | None

    def to_json(self) -> dict[str, Any]:
        """As `diagnosis.json` holds it."""
        return dict(self.diagnosis_json)

    @property
    def verdict(self) -> str:
        """The outcome."""
        return str(self.diagnosis_json["verdict"])

    @property
    def extended_rig(self) -> Rig:
        """The rig with the named causes."""
        return rig_from_text(self.extended_rig_text, "rig_extended.yaml")


class RemoteSession:
    """A session at a service that takes readings.

    Args:
        client: The connection.
        session_id: Id of the session.
    """

    def __init__(self, client: Client, session_id: str) -> None:
        self._client, self.id = client, session_id

    def append(self, readings: Sequence[Mapping[str, Any]]) -> int:
        """Send readings, numbered by `sequence`; the number of those that the service has on disk then."""
        content = b"".join(json.dumps(dict(reading)).encode() + b"\n" for reading in readings)
        headers = {"Content-Type": "application/x-ndjson"}
        path = f"/v1/sessions/{self.id}/readings"
        return int(self._client.request("POST", path, content=content, headers=headers).json()["n_readings"])

    def info(self) -> dict[str, Any]:
        """The session as the service has it: `state`, `n_readings`, `hash` and more."""
        return dict(self._client.request("GET", f"/v1/sessions/{self.id}").json())

    def close(self) -> dict[str, Any]:
        """End the session, so that it can be calibrated; what `info` then says."""
        return dict(self._client.request("POST", f"/v1/sessions/{self.id}/close").json())


class RemoteRegistry:
    """The versions of a rig's calibration at a service.

    Args:
        client: The connection.
        rig_id: Any version of the rig.
    """

    def __init__(self, client: Client, rig_id: str) -> None:
        self._client, self._path = client, f"/v1/rigs/{rig_id}/registry"

    @property
    def current(self) -> int | None:
        """Number of the version in use; None before the first."""
        number = self._client.request("GET", self._path).json()["current"]
        return None if number is None else int(number)

    def calibration(self) -> RemoteCalibration:
        """The current version.

        Raises:
            InvalidInput: There is none.
        """
        calibration_id = self._client.request("GET", self._path).json()["calibration_id"]
        if calibration_id is None:
            raise InvalidInput("registry must have a version; it has none")
        return self._client.calibration(str(calibration_id))

    def versions(self) -> list[dict[str, Any]]:
        """Every version with its parameters, newest first."""
        return list(self._client.pages(f"{self._path}/versions"))

    def entries(self) -> list[dict[str, Any]]:
        """Conclusions and rollbacks, newest first."""
        return list(self._client.pages(f"{self._path}/entries"))

    def roll_back(self, version: int) -> dict[str, Any]:
        """Make an earlier version current again; the entry of the log."""
        return dict(self._client.request("POST", f"{self._path}/roll-back", json={"version": version}).json())


def _sampling(settings: SamplerSettings | None) -> dict[str, Any]:
    """Settings as the service takes them: the seed stands beside."""
    wanted = asdict(settings or SamplerSettings())
    wanted.pop("seed")
    return wanted


def _wish(currents_A: Mapping[str, float], motion: Mapping[str, Tensor] | None) -> dict[str, Any]:
    motions = {name: values.tolist() for name, values in (motion or {}).items()}
    return {"currents_A": dict(currents_A), "motion": motions}


def _zipped(session: Session) -> bytes:
    buffer = io.BytesIO()
    with tempfile.TemporaryDirectory() as folder, zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:
        path = Path(folder) / "session.zarr"
        session.save(path)
        for file in sorted(file for file in path.rglob("*") if file.is_file()):
            archive.write(file, file.relative_to(path).as_posix())
    return buffer.getvalue()


def _sentence(answer: httpx.Response) -> str:
    """What a refusal says."""
    try:
        return str(answer.json()["detail"])
    except (ValueError, KeyError, TypeError):
        return f"service must answer as coilcal does; it says {answer.status_code} {answer.reason_phrase}"


def _pauses(n: int) -> list[float]:
    return [min(FIRST_PAUSE_S * 2.0**i, LONGEST_PAUSE_S) for i in range(n)]


def _parsed(lines: Iterable[str]) -> Iterator[dict[str, str]]:
    """Events of a stream, each by the names of its fields."""
    event: dict[str, str] = {}
    for line in lines:
        if line:
            name, _, value = line.partition(":")
            event[name] = value.removeprefix(" ")
        elif "data" in event:
            yield event
            event = {}


def _nans(values: Any) -> Any:
    """Numbers in nested lists, NaN in place of None."""
    if isinstance(values, list):
        return [_nans(value) for value in values]
    return math.nan if values is None else values
